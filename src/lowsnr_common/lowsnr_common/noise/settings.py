# SPDX-License-Identifier: Apache-2.0
"""The settings of the noise in a cell, one declaration for sensor, detectors and calibration."""

from __future__ import annotations

from dataclasses import dataclass
import math

from lowsnr_common.noise.empirical import Empirical
from lowsnr_common.noise.models import Envelope
from lowsnr_common.noise.models import Gaussian
from lowsnr_common.noise.models import NoiseModel
from lowsnr_common.noise.models import Poisson
from lowsnr_common.noise.models import StudentT
from lowsnr_common.settings.declare import check_settings
from lowsnr_common.settings.declare import setting

_MODELS = ('gaussian', 'student_t', 'rayleigh', 'k', 'poisson', 'empirical')
_LEAST_QUANTILES = 31


@dataclass(frozen=True, kw_only=True)
class Noise:
    """The distribution of the noise in a cell, of the standard deviation ``noise_std``."""

    model: str = setting(
        'gaussian', 'distribution of the noise in a cell; rayleigh and k are envelopes, poisson '
        'counts photons, empirical is learned by learn_noise.py', choices=_MODELS)
    degrees_of_freedom: float = setting(
        4.0, 'degrees of freedom of student_t; few are heavy tails', gt=2.0, le=1000.0)
    shape: float = setting(
        1.0, 'shape of k; small ones are spiky, large ones nearly rayleigh', ge=0.1, le=1000.0)
    background: float = setting(
        4.0, 'photons in a cell without an object, of poisson', ge=0.01, le=1e6)
    quantiles: tuple[float, ...] = setting(
        (), 'quantiles of the noise of empirical, ascending, at equal steps of their log odds '
        'from the probability 1e-6 to 1 - 1e-6 [noise_std]', ge=-1e3, le=1e3)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.model != 'empirical':
            return
        if len(self.quantiles) < _LEAST_QUANTILES:
            raise ValueError(
                f'Noise.quantiles has {len(self.quantiles)} values, must have at least '
                f'{_LEAST_QUANTILES} where model is empirical: learn_noise.py finds them')
        for low, high in zip(self.quantiles, self.quantiles[1:]):
            if high <= low:
                raise ValueError(
                    f'Noise.quantiles has {high:g} after {low:g}, must be in ascending order')

    def of_std(self, std: float) -> NoiseModel:
        """Return the model with a standard deviation."""
        if self.model == 'student_t':
            return StudentT(std, self.degrees_of_freedom)
        if self.model in ('rayleigh', 'k'):
            return Envelope(std, math.inf if self.model == 'rayleigh' else self.shape)
        if self.model == 'poisson':
            return Poisson(std, self.background)
        if self.model == 'empirical':
            return Empirical(std, self.quantiles)
        return Gaussian(std)
