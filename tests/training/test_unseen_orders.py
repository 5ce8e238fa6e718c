"""The sentence about orders that a model does not have is true of the places that were measured."""

import numpy as np
import pytest

from trueangle_training.methods import TrainingReadings
from trueangle_training.methods.registry import load_method


def campaign(faces: int, shift_faces: float, *, runs: int = 3) -> TrainingReadings:
    """Orders 1 to 8 falling as 1/n at three temperatures, noise of 0.2 arcsec."""
    rng = np.random.default_rng(1)
    angles, temperatures, run = [], [], []
    for number in range(3 * runs):
        angles.append((np.arange(faces) + shift_faces * (number % runs)) * 360.0 / faces)
        temperatures.append(np.full(faces, 10.0 + 10.0 * (number // runs)))
        run.append(np.full(faces, number))
    angle_deg = np.concatenate(angles)
    error = sum(20.0 / n * np.cos(np.radians(n * angle_deg)) for n in range(1, 9)) + rng.normal(
        0.0, 0.2, angle_deg.size
    )
    return TrainingReadings(
        angle_deg=angle_deg,
        error_arcsec=error,
        temperature_c=np.concatenate(temperatures),
        run=np.concatenate(run),
    )


def note_of(readings: TrainingReadings) -> str:
    notes = load_method("linear").fit(readings).notes
    return next(note for note in notes if note.startswith("harmonics above"))


def test_faces_of_one_mounting_are_told_to_shift() -> None:
    note = note_of(campaign(23, 0.0))
    assert "above order 11 cannot be told apart by these angles" in note
    assert "shifted by a third of the face pitch would show them" in note


def test_shifted_repeats_are_not_told_to_shift() -> None:
    note = note_of(campaign(23, 1.0 / 3.0))
    assert "above order 22 cannot be told from lower ones and the zeros of the runs by these angles" in note
    assert "shifted" not in note
    assert "only more faces would show them" in note


@pytest.mark.parametrize("places", [90, 360])
def test_a_model_that_ends_before_the_places_do_says_that_it_ends(places: int) -> None:
    note = note_of(campaign(places, 0.0, runs=1))
    assert (
        f"above order 24 are left out of the model, which ends there; these {places} places would show them"
        in note
    )
    assert "shifted" not in note
    assert "cannot be told" not in note
