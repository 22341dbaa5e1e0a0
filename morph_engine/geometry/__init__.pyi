from .neighbor_index import REACH as REACH
from .neighbor_index import NeighborIndex as NeighborIndex
from .point_cloud import extent as extent
from .point_cloud import lengths as lengths
from .point_cloud import outer_radius as outer_radius
from .signed_distance import cloud_distance as cloud_distance
from .signed_distance import mesh_distance as mesh_distance
