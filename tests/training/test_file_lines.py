"""Lines in messages: read at a glance, copied as a whole."""

from hypothesis import given
from hypothesis import strategies as st

from trueangle_training.file_lines import leave_out_advice, line_ranges, lines_text
from trueangle_training.train_options import excluded_rows


def test_one_line_is_a_line_and_many_are_counted() -> None:
    assert lines_text([102]) == "line 102"
    assert lines_text([3, 5]) == "lines 3, 5"
    assert lines_text(range(1, 13)) == "lines 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ... 12 in all"


def test_all_lines_are_in_the_advice() -> None:
    assert leave_out_advice([*range(40, 63), 17, 70]).endswith("--exclude-rows 17,40-62,70")
    assert leave_out_advice(range(1, 400, 2)) == "Mend the file"


@given(st.sets(st.integers(min_value=1, max_value=10**7), min_size=1, max_size=60))
def test_the_option_reads_back_as_the_same_lines(lines: set[int]) -> None:
    option = line_ranges(lines)
    assert option is not None
    assert excluded_rows(option) == lines
