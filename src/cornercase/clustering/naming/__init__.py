"""Names of clusters, built from predicates that hold for the scenarios of a cluster."""
