"""Which entities a driver sees, for other rooms; it is compiled, so they import it where they need it."""

from cornercase.drivers._kernels.visibility import find_visible_others as find_visible_others
