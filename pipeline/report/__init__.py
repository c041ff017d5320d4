"""One self-contained HTML page per scene."""
