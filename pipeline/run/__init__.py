"""Command lines: what stages share, what the Snakefile asks, heliograph doctor and check."""
