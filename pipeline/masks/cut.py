"""Masks along the photos' edges: GrabCut (Rother et al. 2004) between the silhouette of a volume
and its surroundings.

Arrays: odds, log-odds (h, w) that a pixel shows the object; hull, a silhouette (h, w) bool.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from scipy import ndimage

from pipeline.base.progress import progress

SMALLEST_HOLE = 0.003  # of the object's area
SMALL_PART = 0.08  # of the largest part's area, below which a part has to show that it belongs:
PART_ODDS = 1.0  # by mean log-odds above this
LEAST_PART = 30  # and by so many pixels
SURE_GROUND = -2.2  # log-odds at and below which a pixel is background whatever its colour


def grow(mask: np.ndarray, pixels: int) -> np.ndarray:
    """Dilate a mask (h, w) bool by `pixels`, or erode it by as many where they are negative."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(pixels) + 1,) * 2)
    return (cv2.dilate if pixels > 0 else cv2.erode)(mask.astype(np.uint8), kernel).astype(bool)


def cut(lab8: np.ndarray, hull: np.ndarray, odds: np.ndarray, band: int) -> np.ndarray:
    """GrabCut of one photo: sure object inside the hull, sure background outside its surroundings
    and where the evidence for it is strong.
    """
    near = grow(hull, band)
    core = grow(hull, -band)
    if not core.any():
        return hull

    state = np.full(hull.shape, cv2.GC_BGD, np.uint8)
    state[near & (odds > SURE_GROUND)] = cv2.GC_PR_BGD
    state[near & (odds > 1.0)] = cv2.GC_PR_FGD
    state[hull & (odds > -0.7)] = cv2.GC_PR_FGD
    state[core & (odds > 1.0)] = cv2.GC_FGD
    probable = (state == cv2.GC_FGD) | (state == cv2.GC_PR_FGD)
    if not probable.any():  # GrabCut needs colours of both; the evidence speaks against all
        return probable

    rows, columns = np.where(grow(near, 3 * band))
    box = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    cut_state = np.ascontiguousarray(state[box])
    picture = np.ascontiguousarray(lab8[box])
    background = np.zeros((1, 65))  # GrabCut's colour models
    foreground = np.zeros((1, 65))
    if (cut_state != cv2.GC_BGD).all():  # nothing around the object to learn its colours from
        return tidy(probable, odds)
    cv2.setRNGSeed(0)
    # OpenCV's stubs do not know that it may go without a rectangle
    cv2.grabCut(  # type: ignore[call-overload]
        picture, cut_state, None, background, foreground, 3, cv2.GC_INIT_WITH_MASK
    )

    out = np.zeros(hull.shape, bool)
    out[box] = (cut_state == cv2.GC_FGD) | (cut_state == cv2.GC_PR_FGD)
    return tidy(out, odds)


def tidy(mask: np.ndarray, odds: np.ndarray) -> np.ndarray:
    """Smooth by two pixels, fill holes smaller than .3 % of the object, keep the large parts and
    those that the evidence is for: a lamp whose chain is thinner than a pixel hangs by nothing.
    """
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    mask = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, kernel)

    count, labels, stats, _ = cv2.connectedComponentsWithStats(1 - mask)
    holes = stats[1:, cv2.CC_STAT_AREA] < SMALLEST_HOLE * mask.sum()
    mask[np.isin(labels, 1 + np.flatnonzero(holes))] = 1

    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask.astype(bool)
    area = stats[1:, cv2.CC_STAT_AREA]
    for_it = ndimage.mean(odds, labels, np.arange(1, count)) > PART_ODDS
    loose = (area < SMALL_PART * area.max()) & ~(for_it & (area >= LEAST_PART))
    mask[np.isin(labels, 1 + np.flatnonzero(loose))] = 0
    return mask.astype(bool)


def cut_all(
    pictures: dict[str, np.ndarray],
    hulls: dict[str, np.ndarray],
    odds: dict[str, np.ndarray],
    band: float,
    threads: int,
    note: str,
) -> dict[str, np.ndarray]:
    """GrabCut of every photo (CIELAB, uint8) within `band` (fraction of the object's size) of its
    silhouette in `hulls`; photo name -> mask (h, w) bool.
    """
    width = {n: max(3, round(band * np.sqrt(h.sum()) * 1.5)) for n, h in hulls.items()}
    with ThreadPoolExecutor(threads) as pool:
        jobs = {n: pool.submit(cut, pictures[n], hulls[n], odds[n], width[n]) for n in hulls}
        return {n: jobs[n].result() for n in progress(list(jobs), f"cut along edges, {note}")}
