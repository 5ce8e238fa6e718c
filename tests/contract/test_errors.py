"""Messages stay readable whatever stands in a file."""

from trueangle.contract.errors import Fault


def test_a_cell_of_thousands_of_digits_is_quoted_by_its_beginning_and_length() -> None:
    text = str(Fault(where="c.csv line 5", expected="a number", found=f"'{'9' * 5000}'", advice="mend it"))
    assert len(text) < 150
    assert "... (5002 characters)" in text
    assert text.endswith("; mend it")


def test_a_hash_and_a_long_list_are_quoted_whole() -> None:
    found = f"{'a' * 64}, " + ", ".join(f"method-{k}" for k in range(40))
    assert str(Fault(where="x", expected="y", found=found)).endswith(found)
