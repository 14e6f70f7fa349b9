from .coverage import Gaps as Gaps
from .coverage import gaps as gaps
from .write import reduce_study as reduce_study
