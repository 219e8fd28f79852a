"""Tables of docs/study.md: the keys of a study file, from its models, and the responses that a job answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from pydantic import BaseModel

from edmctl.study.responses import RESPONSES, TRUTHS
from edmctl.study.results import TRUTH
from edmctl.study.study_file import StudyFile
from tools.generate.profile_page import section
from tools.generate.text import table

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo


def tables() -> dict[str, str]:
    """Return the tables of the keys, of the responses, and of what only a virtual machine knows."""
    keys = "\n".join(section(*_titled(name, info)) for name, info in StudyFile.model_fields.items())
    told = [(f"`{name}`", known.text) for name, known in RESPONSES.items()]
    true = [(f"`{TRUTH}{name}`", known.text) for name, known in TRUTHS.items()]
    head = ("name", "what it is")
    return {"keys": keys, "responses": table(head, told), "truths": table(head, true)}


def _titled(name: str, info: FieldInfo) -> tuple[str, type[BaseModel]]:
    """The heading of a table of the file, and its model."""
    written = info.annotation
    models = [one for one in (written, *get_args(written)) if _is_model(one)]
    heading = f"`[{name}]`" if _is_model(written) or info.default is None else f"`[[{name}]]`"
    return heading, models[0]


def _is_model(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
