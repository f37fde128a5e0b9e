"""A model whose press file says what was known of coefficients before any run."""

from dataclasses import replace

import numpy as np

from daq.press.press_file import Prior


def knowing(model, **priors):
    """Return the model with priors: by coefficient the median, and the standard deviation of the logarithm."""
    known = {n: Prior(median=median, factor=float(np.exp(sd))) for n, (median, sd) in priors.items()}
    return replace(model, press=model.press.model_copy(update={"priors": known}))
