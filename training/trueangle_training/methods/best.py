"""The average of three estimators that fail in different places: the most accurate, at about a second.

Half of it are shared shapes (`low_rank`), which hold on where no formula fits; the other half is divided between
the network (`fe_gabpnn`) and the kernels (`linear`) by their evidence. The network finds saturations and steps
that kernels smear, and is lost where its few hidden nodes cannot follow; its evidence tells which. What the
estimators differ by counts as uncertainty.
"""

from dataclasses import dataclass, replace

import numpy as np

from trueangle_training.methods import Fit, Progress, TrainingReadings, no_progress
from trueangle_training.methods.fe_gabpnn import DEFAULT_SETTINGS, FeGabpnnSettings, staged_networks
from trueangle_training.methods.linear import LinearFit, plan_notes, plan_settings, staged_linear
from trueangle_training.methods.low_rank import DEFAULT_SAMPLING, GibbsSettings, fit_low_rank
from trueangle_training.methods.posterior import HarmonicPosterior, average
from trueangle_training.methods.stages import Stages

LOW_RANK_SHARE = 0.5
OCCAM_NATS = 6.0
"""The network's evidence is that of its best hidden layer, the kernels' an average: so much is its advantage worth
where both describe a joint equally well."""
TEMPER_NATS = 4.0
"""Evidence is trusted less than Bayes' rule has it: neither model is the truth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BestAverage:
    """The averaged posterior and the shares it was made with."""

    posterior: HarmonicPosterior
    network_share: float
    linear_share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Best:
    """The `Method`."""

    network: FeGabpnnSettings = DEFAULT_SETTINGS
    sampling: GibbsSettings = DEFAULT_SAMPLING
    name: str = "best"
    summary: str = "average of shared shapes, network and kernels: most accurate, about a second"
    stages: Stages | None = None
    """None: every training begins at the beginning."""

    def sharing(self, stages: Stages) -> "Best":
        """The same with stages shared with other methods."""
        return replace(self, stages=stages)

    def fit(self, readings: TrainingReadings, *, seed: int = 0, progress: Progress = no_progress) -> Fit:
        """Train all three and average; the same readings and seed give the same model."""
        linear = staged_linear(self.stages, readings)
        averaged = fit_best(
            linear,
            seed=seed,
            network=self.network,
            sampling=self.sampling,
            progress=progress,
            stages=self.stages,
        )
        settings = {
            **plan_settings(linear),
            "share_of_low_rank": LOW_RANK_SHARE,
            "share_of_network": round(averaged.network_share, 6),
            "share_of_linear": round(averaged.linear_share, 6),
            "modes": self.sampling.modes,
            "chains": self.sampling.chains,
            "sweeps": self.sampling.sweeps,
        }
        return Fit(model=linear.model_of(averaged.posterior), notes=plan_notes(linear), settings=settings)


def make(base_temperature_c: float) -> Best:
    """The method; no temperature is its base."""
    del base_temperature_c
    return Best()


def fit_best(
    linear: LinearFit,
    *,
    seed: int = 0,
    network: FeGabpnnSettings = DEFAULT_SETTINGS,
    sampling: GibbsSettings = DEFAULT_SAMPLING,
    progress: Progress = no_progress,
    stages: Stages | None = None,
) -> BestAverage:
    """Average on a campaign that `linear` has reduced."""
    steps = len(network.hidden_nodes) + 1
    networks = staged_networks(
        stages, linear, seed=seed, settings=network, progress=lambda done, _: progress(done, steps)
    )
    low_rank = fit_low_rank(linear, seed=seed, settings=sampling)
    progress(steps, steps)
    advantage = max(networks.log_evidence) - linear.mixture.log_evidence - OCCAM_NATS
    favour = 1.0 / (1.0 + np.exp(-np.clip(advantage / TEMPER_NATS, -50.0, 50.0)))
    network_share = (1.0 - LOW_RANK_SHARE) * float(favour)
    linear_share = 1.0 - LOW_RANK_SHARE - network_share
    posterior = average(
        [linear.posterior, networks.posterior, low_rank], [linear_share, network_share, LOW_RANK_SHARE]
    )
    return BestAverage(posterior=posterior, network_share=network_share, linear_share=linear_share)
