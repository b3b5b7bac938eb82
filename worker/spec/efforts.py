"""Efforts: windows of a sweep by a name, resolved into plain fields when a specification is read."""

from typing import Any, Final, Literal

Effort = Literal["draft", "standard", "thorough"]

#: The fields of each effort (docs/accuracy.md has what each shows wrong, and its cost).
EFFORTS: Final[dict[str, dict[str, Any]]] = {
    "draft": {"settle": "auto", "observe": 30, "until": 260},
    "standard": {"settle": "auto", "observe": 100, "until": None},
    "thorough": {"settle": "auto", "observe": 1000, "until": None},
}
