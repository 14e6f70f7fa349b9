"""Live page: report of a study that grows while scenarios are run."""
