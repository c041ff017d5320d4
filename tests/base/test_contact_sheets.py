"""Contact sheets: how pictures are laid out in rows."""

from __future__ import annotations

import numpy as np

from pipeline.base.images import FEWEST_IN_ROW, FILLED, MOST_IN_ROW, full_rows, in_rows


def tile(value: int, width: int = 6) -> np.ndarray:
    return np.full((4, width, 3), value, np.uint8)


def test_the_last_row_lacks_as_few_as_it_can():
    assert full_rows(3) == 3 and full_rows(16) == 8 and full_rows(18) == 6
    for count in range(MOST_IN_ROW + 1, 60):
        lacks = -count % full_rows(count)
        assert all(lacks <= -count % other for other in range(FEWEST_IN_ROW, MOST_IN_ROW + 1))


def test_pictures_stand_in_order_and_the_rest_is_grey():
    sheet = in_rows([tile(value) for value in range(10, 21)], 6)
    assert sheet.shape == (8, 36, 3)
    assert [int(v) for v in sheet[0, ::6, 0]] == [10, 11, 12, 13, 14, 15]
    assert [int(v) for v in sheet[4, ::6, 0]] == [16, 17, 18, 19, 20, FILLED]


def test_a_narrow_picture_is_filled_up_beside_it():
    sheet = in_rows([tile(10), tile(11, width=2)])
    assert sheet.shape == (4, 12, 3)
    assert (sheet[:, 6:8] == 11).all() and (sheet[:, 8:] == FILLED).all()
