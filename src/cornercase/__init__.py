"""Find, cluster and reduce the critical concrete scenarios of a logical scenario."""

__version__ = "0.1.0"
