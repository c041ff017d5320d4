"""Tables of the ladder's rows."""

from benchmarks.ladder_tables import photos, rungs, truths, worst


def row(name, before, after, relit):
    true = lambda value: (
        dict.fromkeys(
            ("novel_view_psnr", "relight_psnr_channel", "albedo_mse", "albedo_mse_channel")
            + ("roughness_mse", "metallic_mse"),
            0.25,
        )
        | {"relight_psnr": value}
    )
    common = {"held_out_standard_error": 0.08, "cpu_seconds": 20.0, "metal_share": 0.5}
    return {
        "set": name,
        "sample": 0,
        "unlit": {"robust": 29.0, "plain": 29.1},
        "maps": common | {"held_out_psnr": before, "rungs": [], "truth": true(relit[0])},
        "tested": common
        | {
            "held_out_psnr": after,
            "rungs": [("matt", 0.5), ("one gloss", 0.2), ("matt", 0.3), ("gloss map", 0.0)],
            "truth": true(relit[1]),
        },
    }


ROWS = [row("garden", 28.5, 29.25, (20.0, 21.5)), row("w_bowl__room_1", 30.0, 30.0, (22.0, 21.8))]


def test_rungs_of_one_name_are_added_and_empty_ones_left_out():
    assert rungs(ROWS[0]) == "matt .80, one gloss .20"


def test_lit_stands_beside_unlit():
    line = photos(ROWS).splitlines()[2]
    assert "| 29.00 | 28.50 | 29.25 | +0.25 | .08 |" in line and ".50 \\| .50" in line


def test_before_and_after_and_their_means():
    lines = truths(ROWS).splitlines()
    assert "bowl, room_1" in lines[3] and "22.0 \\| 21.8" in lines[3]
    assert "**mean of 2**" in lines[4] and "21.0 \\| 21.6" in lines[4]
    assert "29.2 \\| 29.6" in lines[4]


def test_the_largest_loss_is_said():
    said = worst(ROWS)
    assert "1 of 2 samples gain" in said and "+0.65 dB" in said
    assert "loss 0.20 dB (bowl, room_1)" in said
