"""Heliograph: photos in, relightable USD assets out, with the ambiguity kept.

A folder imports only from those above it (tests/test_layers.py guards this):
base | geometry | photos | masks | surface | render | prior | posterior | usd | report | run.
"""

from pipeline.base import runtime

__version__ = "0.1.0"

runtime.point_at_llvm()  # before anything imports drjit: the system's LLVM may be one that aborts
