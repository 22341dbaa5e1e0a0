from .amsgrad import AMSGrad as AMSGrad
from .control_lattice import ControlLattice as ControlLattice
from .frame_optimizer import FrameOptimizer as FrameOptimizer
from .frame_optimizer import FrameReport as FrameReport
from .schedule import FrameWeights as FrameWeights
from .schedule import joint_weights as joint_weights
from .schedule import physics_weights as physics_weights
from .watchdog import Event as Event
