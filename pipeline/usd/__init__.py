"""USD out: one stage with a variant per posterior sample (light and textures switch together), and one flat file each."""

from .check import check
from .write import export

__all__ = ["check", "export"]
