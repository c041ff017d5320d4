"""Tables of README.md and docs/ from the rows in benchmarks/results/."""
