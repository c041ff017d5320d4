"""What everything else stands on: errors, files, progress, run-time surroundings, configuration,
images.
"""
