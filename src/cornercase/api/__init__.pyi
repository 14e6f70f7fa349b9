from ._compare_studies import Comparison as Comparison
from ._compare_studies import compare as compare
from ._study import Study as Study
from ._suite import Suite as Suite
from ._written_page import Page as Page
