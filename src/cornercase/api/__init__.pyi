from ._study import Study as Study
