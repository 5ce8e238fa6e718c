"""Draws in each run are told from what only looks like them."""

import numpy as np
import pytest

from trueangle_training.diagnosis.random_draws import follow_temperature, keep_one_phase

TEMPERATURE_C = np.repeat(np.arange(10.0, 41.0, 5.0), 3)


def drawn(seed: int, size: int = TEMPERATURE_C.size) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=size) + 1j * rng.normal(size=size)


def test_draws_are_not_taken_for_an_effect_of_temperature() -> None:
    alarms = sum(
        keep_one_phase(drawn(seed)) or follow_temperature(drawn(seed), TEMPERATURE_C) for seed in range(500)
    )
    # 1e-4 and 1e-3 a set: more than 4 of 500 once in 3000 times.
    assert alarms <= 4


@pytest.mark.parametrize("seed", range(5))
def test_amplitudes_that_decay_after_each_step_of_temperature_are_no_draws(seed: int) -> None:
    after_step = np.array([0.0, 0.0, 0.0, *np.tile([1.0, 0.4, 0.15], 6)])
    amplitude = 3.0 * np.exp(0.7j) * after_step + 0.1 * drawn(seed)
    assert follow_temperature(amplitude, TEMPERATURE_C)


@pytest.mark.parametrize("seed", range(5))
def test_a_response_bent_in_temperature_is_no_draw(seed: int) -> None:
    t = (TEMPERATURE_C - 25.0) / 15.0
    amplitude = 2.0 * np.exp(0.2j) * t**2 + np.exp(1.4j) * t + 0.2 * drawn(seed)
    assert follow_temperature(amplitude, TEMPERATURE_C)


@pytest.mark.parametrize("seed", range(5))
def test_amplitudes_of_one_phase_are_no_draws(seed: int) -> None:
    rng = np.random.default_rng(seed)
    amplitude = rng.normal(size=TEMPERATURE_C.size) * np.exp(2.1j) + 0.15 * drawn(seed + 50)
    assert keep_one_phase(amplitude)
    assert not keep_one_phase(drawn(seed + 900))
