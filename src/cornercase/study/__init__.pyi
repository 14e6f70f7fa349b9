from .importing import IMPORTED as IMPORTED
from .importing import ImportResult as ImportResult
from .importing import import_recordings as import_recordings
from .meta import StudyMeta as StudyMeta
from .opening import open_study as open_study
from .store import Study as Study
from .table import Row as Row
