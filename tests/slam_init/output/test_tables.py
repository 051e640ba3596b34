"""Tables in markdown."""

from slam_init.output.tables import markdown_table


def test_a_table_has_aligned_columns_and_does_not_change_its_cells():
    rows = [["much longer", "1.23", "1e5"], ["b", "-", "0.10"]]
    lines = markdown_table(["a", "long", "text"], rows).splitlines()
    assert len({len(line) for line in lines}) == 1
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert cells[0] == ["a", "long", "text"]
    assert cells[2:] == [["much longer", "1.23", "1e5"], ["b", "-", "0.10"]]
    assert [rule.startswith(":") for rule in cells[1]] == [True, False, False]
    assert [rule.endswith(":") for rule in cells[1]] == [False, True, True]
