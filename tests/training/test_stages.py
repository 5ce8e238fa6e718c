"""Methods that share stages give what they give alone, and do each stage once."""

import dataclasses

import numpy as np
from tests.benchmarks.families import draw_campaign, draw_joint
from tests.training.test_linear import readings_of

from trueangle_training.evaluation.comparison import compare_methods
from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.best import Best
from trueangle_training.methods.fe_gabpnn import FeGabpnn, FeGabpnnSettings
from trueangle_training.methods.linear import Linear
from trueangle_training.methods.low_rank import GibbsSettings
from trueangle_training.methods.stages import StagedMethod, Stages, staged

SMALL = FeGabpnnSettings(hidden_nodes=(2,), individuals=6, generations=2)
QUICK = GibbsSettings(chains=1, sweeps=30, burn_in=10)
METHODS = (Linear(), FeGabpnn(settings=SMALL), Best(network=SMALL, sampling=QUICK))
# Missing readings couple the harmonics; four temperatures and two repeats keep it short.
READINGS = readings_of(
    draw_campaign(draw_joint("n3q", 1), 1, temperatures_c=(10.0, 20.0, 30.0, 40.0), repeats=2, missing=0.05)
)


@dataclasses.dataclass(frozen=True)
class Alone:
    """A method that hides that it could share."""

    method: Linear | FeGabpnn | Best

    @property
    def name(self) -> str:
        return self.method.name

    @property
    def summary(self) -> str:
        return self.method.summary

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        return self.method.fit(readings, seed=seed, progress=progress)


def test_shared_stages_change_no_model() -> None:
    stages = Stages()
    angle_deg = np.linspace(0.0, 359.0, 100)
    for temperature_c in (np.full(100, 12.0), np.full(100, 31.0)):
        for method in METHODS:
            assert isinstance(method, StagedMethod)
            alone, shared = method.fit(READINGS, seed=3), method.sharing(stages).fit(READINGS, seed=3)
            one, other = (fit.model.error_arcsec(angle_deg, temperature_c) for fit in (alone, shared))
            assert (one == other).all()
            assert alone.settings == shared.settings


def test_a_stage_is_made_once_for_each_readings_and_settings() -> None:
    made: list[str] = []

    def make(name: str) -> str:
        made.append(name)
        return name

    stages = Stages()
    other = dataclasses.replace(READINGS, error_arcsec=READINGS.error_arcsec + 1e-9)
    moved = dataclasses.replace(READINGS, datum_deg=1.0)
    copy = dataclasses.replace(READINGS, error_arcsec=READINGS.error_arcsec.copy())
    for readings, settings, name in (
        (READINGS, 0, "first"),
        (copy, 0, "first"),
        (READINGS, 1, "other settings"),
        (other, 0, "other readings"),
        (moved, 0, "other datum"),
    ):
        assert staged(stages, "stage", readings, settings, lambda name=name: make(name)) == name
    assert made == ["first", "other settings", "other readings", "other datum"]
    assert staged(None, "stage", READINGS, 0, lambda: make("unshared")) == "unshared"
    assert stages.once("other stage", READINGS, 0, lambda: make("other stage")) == "other stage"


def test_a_comparison_of_methods_that_share_says_the_same() -> None:
    together, alone = (
        compare_methods(
            READINGS,
            methods,
            noise_arcsec=None,
            joint=None,
            seed=1,
            clock=lambda: 0.0,
            progress=no_progress,
        )
        for methods in (METHODS, tuple(Alone(method) for method in METHODS))
    )
    assert together == alone
