from ._import_recordings import ImportResult as ImportResult
from ._import_recordings import import_recordings as import_recordings
from ._meta import StudyMeta as StudyMeta
from ._notes import write_note as write_note
from ._scenario_table import ScenarioRecord as ScenarioRecord
from ._study_file import StudyFile as StudyFile
from ._verify import Verification as Verification
from ._verify import verify as verify
