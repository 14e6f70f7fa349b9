from .critical_set import REGION as REGION
from .critical_set import CriticalSet as CriticalSet
from .critical_set import Estimate as Estimate
from .gaussian_process import GaussianProcess as GaussianProcess
from .gaussian_process import boundary_process as boundary_process
from .gaussian_process import encoded as encoded
from .sensitivity import Sensitivity as Sensitivity
from .sensitivity import estimate_sensitivity as estimate_sensitivity
