"""How many test cases one question holds, and how many questions are put side by side."""

from __future__ import annotations

import pytest

from saflite.scorer_pool.llm.batch_size import BatchSizer


def test_pace_asks_about_as_many_as_fit_into_the_deadline() -> None:
    sizer = BatchSizer()
    sizer.answered(10, 20.0)
    assert sizer.per_question(60.0) == 12
    assert sizer.per_question(10.0) == 2
    assert sizer.per_question(1.0) == 1
    sizer.missed(2)
    assert sizer.per_question(60.0) == 1


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [({1: 1.0, 2: 2.0, 4: 4.0}, 1), ({1: 1.0, 2: 1.1, 4: 2.2}, 2), ({1: 1.0, 2: 1.1, 4: 1.3}, 4), ({}, 1)],
)
def test_pace_puts_questions_side_by_side_only_where_that_answers_more(
    seconds: dict[int, float], expected: int
) -> None:
    sizer = BatchSizer()
    sizer.probed(seconds)
    assert sizer.side_by_side == expected
