"""Tables: alignment, places and shades of ranked numbers, and the five formats."""

import csv
import io
import math
import re
from operator import itemgetter

import pytest

from depthcli.show.table import FORMATS, Column, Number, Table, to_csv
from tests.golden import Same

NAN = math.nan


@pytest.mark.parametrize(("values", "larger", "places"), [
    ((3.0, 1.0, 2.0), False, [0, 1, 2]),
    ((3.0, 1.0, 2.0), True, [1, 0, 2]),
    ((1.0, 1.001, 2.0, 3.0), False, [1, 1, 2, 0]),  # they read alike
    ((NAN, 5.0), False, [0, 1]),
    ((5.0,), False, [0]),
    ((1.0, 2.0), None, [0, 0]),
    ((-0.001, 0.001, 1.0), False, [1, 1, 2]),
])  # fmt: skip
def test_places(values: tuple[float, ...], larger: bool | None, places: list[int]):
    assert Table("t", [Column("c", Number, larger)], values).places(0) == places


def test_a_number_keeps_its_value():
    numbers = (Number(1.234), Number(1.234, 1), Number(2, mark="*"), Number(NAN, mark="*"))
    assert numbers == ("1.23", "1.2", "2.00*", "-")
    assert Number(1.234).value == 1.234


def test_every_format_of_two_tables(same: Same):
    """With all digits and no marks in CSV, where several tables have one header; escaped where signs have a meaning."""
    columns = [Column("run", itemgetter(0)), Column("s & t", itemgetter(1), False), Column("up", itemgetter(2), True)]
    rows = (("x|y_1", Number(1.234), Number(0.5, 1)), ("two", Number(2.0, mark="*"), Number(NAN, 1)))
    first = Table("A_b, 50 %", columns, rows, "a note")
    second = Table.of_cells("t2", ("run", "b", "up", "up"), (("y", Number(3.0), Number(4.0), Number(5.0)),))
    same("tables.txt", "\n".join(f"{name}:\n{write([first, second])}" for name, write in FORMATS.items()))


HOSTILE = (
    "<script>alert(1)</script>", "[x](javascript:alert(1))", "![x](http://e.org/x.png)", "`code`", "a\nb | c",
    "\r\n## d", "\x1b[31mred\x1b[0m", "\x9b2J", "&lt;b&gt;", "[5pt] & \\\\ \\input{x}", "$^~#%_{}", "\u2028x", "\udcff",
)  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_names_are_written_as_plain_text(name: str):
    """A name changes neither the number of lines nor of columns, and is no HTML, link, code, command or escape."""
    plain, odd = (
        Table.of_cells(each, ("run", each), ((each, Number(1.0)), ("b", Number(2.0))), each) for each in ("x", name)
    )
    for write in (Table.text, Table.markdown, Table.latex):
        text = write(odd)
        assert text.count("\n") == write(plain).count("\n")
        assert text.replace("\n", "").isprintable()
    assert not re.search(r"(?<!\\)[<`\[\]]|&(?=#?\w+;)(?<!\\&)", odd.markdown())
    rows = [line for line in odd.markdown().splitlines() if line.startswith("| ")]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {3}
    latex = odd.latex().splitlines()
    assert {len(re.findall(r"(?<!\\)&", row)) for row in latex if row.endswith("\\\\")} == {1}
    assert not any(line.startswith("[") for line in latex)
    assert re.findall(r"\\[a-z]+", odd.latex().replace(r"\begin", "").replace(r"\end", "")).count(r"\input") == 0
    cells = [cell for row in csv.reader(io.StringIO(FORMATS["csv"]([odd]))) for cell in row]
    assert all(cell.isprintable() for cell in cells)


@pytest.mark.parametrize("name", ["=1+1", "+1+1", "-1+1", "@SUM(A1)", " =1+1", "\t=1+1", '=HYPERLINK("x")'])
def test_no_cell_is_a_formula(name: str):
    table = Table.of_cells(name, ("run", name), ((name, Number(-1.5)), ("-", "-3")))
    ours = to_csv([{"scene": name, "value": -1.5, "text": "-3", "none": "-"}])
    for text in (FORMATS["csv"]([table]), ours):
        cells = [cell for row in csv.reader(io.StringIO(text)) for cell in row]
        assert not any(cell.strip().startswith(tuple("=+@")) for cell in cells)
        assert {cell for cell in cells if cell.startswith("-")} == {"-1.5", "-3", "-"}
