"""Failure modes, each with a knob, a curve and a stated limit."""
