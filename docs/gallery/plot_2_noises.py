# SPDX-License-Identifier: Apache-2.0
"""
Other noise than Gaussian
=========================

The log-likelihood ratio that a measurement gives for an object of 9 dB, in four models of noise.
In Gaussian noise it is a straight line; in noise with heavy tails a very bright cell tells less
than a bright one.
"""

from lowsnr_common.core.measurement import SensorModel
from lowsnr_common.noise.settings import Noise
import matplotlib.pyplot as plt
import numpy as np

z = np.linspace(-2.5, 9, 300)
figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), sharex=True, layout='constrained')
for axis, model in zip(axes, ('gaussian', 'student_t', 'rayleigh', 'k'), strict=True):
    sensor = SensorModel(snr_db=9.0, noise=Noise(model=model))
    axis.plot(z, sensor.log_likelihood_ratio(z[None])[0], color='#E69F00')
    axis.set(title=model, xlabel='measurement [sigma]', ylim=(-8, 25))
axes[0].set(ylabel='ln L [nat]')

# %%
# What such noise looks like, 20 x 20 cells without an object:

rng = np.random.default_rng(0)
figure, axes = plt.subplots(1, 4, figsize=(11, 3), layout='constrained')
for axis, model in zip(axes, ('gaussian', 'student_t', 'rayleigh', 'k'), strict=True):
    noise = SensorModel(snr_db=9.0, noise=Noise(model=model)).noise_model
    axis.imshow(noise.draw(np.zeros((20, 20)), rng), cmap='gray', vmin=-3, vmax=5)
    axis.set(title=model, xticks=[], yticks=[])
plt.show()
