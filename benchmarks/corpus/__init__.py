"""Bad input: cases made by code, each of which must end in a right result or in one message."""
