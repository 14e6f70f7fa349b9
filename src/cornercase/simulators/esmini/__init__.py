"""esmini as a simulator, through its library."""
