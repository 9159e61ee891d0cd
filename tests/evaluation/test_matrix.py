"""Wide tables: places, shades, and the three formats."""

from __future__ import annotations

import csv
import io
import math

import pytest

from depthcli.evaluation.matrix import Column, Matrix, best_of

NAN = math.nan


@pytest.mark.parametrize(
    ("values", "larger", "places"),
    [
        ((3.0, 1.0, 2.0), False, [0, 1, 2]),
        ((3.0, 1.0, 2.0), True, [1, 0, 2]),
        ((1.0, 1.001, 2.0, 3.0), False, [1, 1, 2, 0]),  # they read alike
        ((NAN, 5.0), False, [0, 1]),
        ((5.0,), False, [0]),
        ((1.0, 2.0), None, [0, 0]),
        ((-0.001, 0.001, 1.0), False, [1, 1, 2]),
    ],
)
def test_places(values: tuple[float, ...], larger: bool | None, places: list[int]):
    assert Column("c", values, larger).places == places


def test_shades():
    assert Column("c", (2.0, 3.0, 4.0, 9.0, NAN)).shades == [0.0, 0.5, 1.0, 1.0, 0.0]
    assert Column("c", (50.0, 100.0), True).shades == [0.5, 0.0]
    assert Column("c", (0.0, 0.0, 1.0)).shades == [0.0, 0.0, 1.0]
    assert best_of((3.0, NAN, 1.0), False) == [2, 0]
    assert best_of((3.0, NAN, 1.0), True) == [0, 2]


MATRIX = Matrix(
    "A_b, 50 %",
    ("x|y_1", "two"),
    (Column("s & t", (1.234, 2.0), False, ("", "*")), Column("up", (0.5, NAN), True, digits=1)),
    "a note",
)


def test_markdown():
    text = MATRIX.markdown()
    assert text.splitlines()[2:6] == [
        "| run | s & t | up |",
        "| --- | ---: | ---: |",
        "| x\\|y_1 | **1.23** | **0.5** |",
        "| two | <u>2.00*</u> | - |",
    ]
    assert text.startswith("## A_b, 50 %\n")
    assert text.endswith("a note\n")


def test_latex():
    text = MATRIX.latex()
    assert r"\caption{A\_b, 50 \%}" in text
    assert r"run & s \& t & up \\" in text
    assert r"x|y\_1 & \textbf{1.23} & \textbf{0.5} \\" in text
    assert r"two & \underline{2.00*} & - \\" in text
    assert r"\begin{tabular}{lrr}" in text
    assert text.count("{") == text.count("}")


def test_csv_has_all_digits_and_no_marks():
    rows = list(csv.reader(io.StringIO(MATRIX.csv())))
    assert rows == [
        ["table", "run", "s & t", "up"],
        ["A_b, 50 %", "x|y_1", "1.234", "0.5"],
        ["A_b, 50 %", "two", "2.0", ""],
    ]
