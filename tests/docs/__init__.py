"""The pages: their tables, links and paths."""
