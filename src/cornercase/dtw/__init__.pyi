from .distances import distance_matrix as distance_matrix
from .distances import distances_to as distances_to
from .distances import kernel_matrix as kernel_matrix
