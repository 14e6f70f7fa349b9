"""The study of the public API."""

from __future__ import annotations

from cornercase.study import StudyFile

Study = StudyFile
