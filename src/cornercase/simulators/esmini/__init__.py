"""esmini by its library."""
