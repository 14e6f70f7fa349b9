"""Names of clusters, built from predicates (short statements) that are true of the scenarios of a cluster."""
