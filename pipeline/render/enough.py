"""Whether the samples that are there are enough, for `samples: auto`: how much they differ says how
many make their mean known well enough (`samples_needed`).

Few samples tell badly how much they differ, so their number is at most doubled before it is judged
again.
"""

from __future__ import annotations

from pipeline.render.samples import KNOWN_TO, Samples, Spread, mean_square, samples_needed


def judged(samples: Samples, most: int) -> dict:
    """How many samples there are and how many there shall be (`samples`, at most `most` of them),
    and on which evidence: `needed`, and the root mean square deviation of their base colours,
    `spread`, sRGB. Raises InputError where samples are missing.
    """
    spread = Spread.of(samples)
    assert spread is not None  # there are several of them
    square = mean_square(spread, samples.texels)
    needed, count = samples_needed(square), len(samples)
    return {
        "drawn": count,
        "needed": needed,
        "samples": max(count, min(needed, 2 * count, most)),
        "spread": square**0.5,
        "known_to": KNOWN_TO,
    }
