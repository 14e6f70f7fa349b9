from ._distance_matrix import distance_matrix as distance_matrix
from ._distance_matrix import distances_to as distances_to
from ._distance_matrix import kernel_matrix as kernel_matrix
