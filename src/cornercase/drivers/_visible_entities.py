"""Function that finds the entities in a driver's sight; slow to import, so import this module only when needed."""

from cornercase.drivers._kernels.visibility import find_visible_others as find_visible_others
