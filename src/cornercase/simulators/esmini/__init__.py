"""esmini, through its library."""
