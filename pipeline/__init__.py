"""Heliograph: photos in, relightable USD assets out, with the ambiguity kept.

Import direction, top to bottom; a module imports only from those above it:
errors, files, progress, runtime | config | images | cameras | capture | poses | masks | surface | atlas |
envmap | optics | observe | prior | posterior | metrics | usd | report.
"""

__version__ = "0.1.0"

from . import runtime

runtime.point_at_llvm()          # before anything imports drjit: the system's LLVM may be one that aborts
