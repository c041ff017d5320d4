"""What a run costs against how much there is to do: photos, texels, samples, triangles."""
