"""The comparative study: every method on every scene of a suite, with known truth."""
