from .neighbor_index import REACH as REACH
from .neighbor_index import NeighborIndex as NeighborIndex
