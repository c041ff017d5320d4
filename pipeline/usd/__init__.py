"""What users take away: USD files, checked."""
