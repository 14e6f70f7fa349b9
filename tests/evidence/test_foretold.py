"""Features that are foretold from the parameters."""

import numpy as np
from scipy.stats import qmc

from cornercase.evidence.foretold import Foretold


def test_smooth_features_are_foretold_without_rounding_errors():
    def features(points):
        x, y = points.T
        return np.stack([np.sin(3.0 * x) + y**2, np.exp(-x) * y], axis=1)

    known = qmc.Sobol(2, seed=1).random(512)
    others = 0.05 + 0.9 * qmc.Sobol(2, seed=2).random(256)
    of_known = features(known)
    expected = (features(others) - of_known.mean(axis=0)) / of_known.std(axis=0)
    # Weights of 1e5 and more cancel: in single precision this was off by 0.1.
    np.testing.assert_allclose(Foretold(known, of_known).predict(others), expected, atol=2e-3)
