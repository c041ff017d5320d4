"""The prior of materials against measured ones (CC0)."""

import csv
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.special import gammaln

from pipeline.posterior.split_gibbs.lobes import METALLIC
from pipeline.posterior.split_gibbs.material_prior import (
    BLACK,
    BODY,
    COATED,
    DIELECTRIC,
    DIELECTRIC_TINT,
    KIND_SHARE,
    METAL,
    METAL_TINT,
    TAIL,
    TINTS,
    joint_parts,
    log_joint_of,
    log_joint_prior,
    log_own_prior,
    log_roughness,
    unlike_metal,
)
from pipeline.posterior.split_gibbs.state import RegionMaterials

TABLE = Path(__file__).parent / "measured_materials.csv"


def measured(metalness: str) -> dict[str, np.ndarray]:
    """Base colour (3,) of every measured material of a kind, by name."""
    lines = [line for line in TABLE.read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    return {
        row["name"]: np.clip([float(row[c]) for c in "rgb"], 1e-3, 0.97)
        for row in csv.DictReader(lines)
        if row["metalness"] == metalness
    }


def test_measured_materials_are_within_the_prior_of_their_kind():
    """Brightness and both tints: at least nine of ten lie in the 95 % interval, and not all of them
    in the middle half.
    """
    for metalness, bright, tint in (
        ("0", DIELECTRIC, DIELECTRIC_TINT),
        ("1", METAL, METAL_TINT),
    ):
        log_color = np.log(np.array(list(measured(metalness).values())) + BLACK)
        far = np.column_stack(
            [(log_color.mean(1) - bright[0]) / bright[1], (log_color @ TINTS.T - tint[0]) / tint[1]]
        )
        inside = np.abs(far) < stats.t.ppf(0.975, TAIL)
        assert len(far) > 30 and (inside.mean(0) > 0.9).all()
        assert (np.abs(far) < stats.t.ppf(0.75, TAIL)).all(1).mean() < 0.8


def odds_of_metal(color: np.ndarray, roughness: int) -> float:
    """Log odds of metal against dielectric for one region of a colour (3,) and a roughness step."""

    def log_density(metallic: float) -> float:
        steps = (0.08, 0.2, 0.4, 0.65, 1.0)
        one = RegionMaterials(color[None], np.ones(1), np.array([roughness]), np.array([metallic]))
        return log_joint_prior(one.color, one.metallic) + float(log_own_prior(one, steps)[0])

    return log_density(1.0) - log_density(0.0)


def test_colours_tell_metals_from_dielectrics():
    """Fruit, brick, soil and black things are no metals; of measured metals none is ruled out; and
    what is rough is seldom one.
    """
    metals, others = measured("1"), measured("0")
    plain = ["Carrot", "Lemon", "Orange", "Ketchup", "Terracotta", "Brick", "Tire", "Toner (Black)"]
    assert max(odds_of_metal(others[name], 2) for name in plain) < -2.5
    # anodised ones are dyed oxide on metal
    of_metals = [odds_of_metal(c, 1) for name, c in metals.items() if "Anodized" not in name]
    assert min(of_metals) > -3 and np.median(of_metals) > 0
    assert odds_of_metal(metals["Iron"], 4) < odds_of_metal(metals["Iron"], 2) - 1.5


def test_no_bare_metal_is_dark_or_dyed():
    """Nothing speaks against the measured ones; much does against lemon, green paint and soot."""
    bare = np.array([c for name, c in measured("1").items() if "Anodized" not in name])
    assert unlike_metal(bare).max() < 0.2
    lemon, paint, soot = [0.617, 0.366, 0.045], [0.0, 0.19, 0.02], [0.04, 0.04, 0.04]
    assert (unlike_metal(np.array([lemon, paint, soot])) > 5).all()


def test_a_coated_metal_is_rare_and_not_ruled_out():
    """Anodised red and candy green cost as much as coatings are rare, however far out they are."""
    red, green = measured("1")["Aluminum (Anodized Red)"], np.array([0.01, 0.19, 0.01])
    against = unlike_metal(np.array([red, green]))
    np.testing.assert_allclose(against, -np.log(COATED), atol=0.01)


def test_shares_and_roughness_are_probabilities():
    assert len(KIND_SHARE) == len(METALLIC) and abs(KIND_SHARE.sum() - 1) < 1e-12
    np.testing.assert_allclose(np.exp(log_roughness((0.1, 0.3, 0.9))).sum(1), 1)


def test_a_body_is_of_one_kind_however_it_was_cut():
    """Sums over the kinds of six regions, without their colours: half a metal body is rarer than a
    whole one, and a whole one not many times rarer than one region of it.
    """

    def chance(metals: int, regions: int) -> float:
        """That these regions are metal and the others dielectric, in one order."""
        count = np.array([regions - metals, metals])
        alpha = BODY * KIND_SHARE
        return np.exp(
            gammaln(alpha + count).sum()
            - gammaln(alpha).sum()
            + gammaln(BODY)
            - gammaln(BODY + regions)
        )

    many = np.full((6, 3), 0.5)
    for metals in (0, 3, 6):
        kinds = np.repeat([1.0, 0.0], [metals, 6 - metals])
        parts = joint_parts(many, kinds).sum(0)
        apart = parts.copy()
        apart[6:] = [6, 0]
        found = log_joint_of(parts, 6) - log_joint_of(apart, 6)
        np.testing.assert_allclose(found, np.log(chance(metals, 6) / chance(0, 6)))

    assert chance(6, 6) > 0.2 * chance(1, 1)
    assert chance(6, 6) > 10 * chance(3, 6)
