"""Encoder settings compare field by field; counts become degrees in integers first."""

from hypothesis import given
from hypothesis import strategies as st

from trueangle.contract.encoder import EncoderSettings, counts_to_deg, resolution_arcsec


def test_an_open_field_is_not_compared() -> None:
    found = EncoderSettings(serial_number=7, preset_value=12)
    assert found.differences_from(EncoderSettings(serial_number=7)) == []


def test_each_difference_names_field_expected_and_found() -> None:
    found = EncoderSettings(serial_number=7, preset_value=0)
    expected = EncoderSettings(serial_number=8, preset_value=0, operating_parameters=1)
    assert found.differences_from(expected) == [
        "serial_number expected 8 found 7",
        "operating_parameters expected 1 found not readable",
    ]


@given(st.integers(min_value=0, max_value=2**32 - 1), st.integers(min_value=2, max_value=2**32))
def test_counts_lie_on_one_turn(counts: int, per_rev: int) -> None:
    assert 0.0 <= counts_to_deg(counts, per_rev) < 360.0


def test_a_quarter_turn_of_the_mercury_3000() -> None:
    # 3,276,800 counts a turn: the 0.39 arcsec that Jia et al. 2020, section 2 state
    assert counts_to_deg(819_200 + 5 * 3_276_800, 3_276_800) == 90.0
    assert abs(resolution_arcsec(3_276_800) - 0.39551) < 1e-5
