"""Write the client's methods, one for each view: `python -m service.views.client_methods`.

The client and the commands read that file, since a client's installation lacks the kernel and the server, and
the commands load no client to show their help. A test compares it with the registry.
"""

import sys
from collections.abc import Sequence
from inspect import cleandoc
from pathlib import Path
from textwrap import fill, indent
from types import UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from service.views.registry import SPRINGS, VIEWS
from service.views.view import View

FILE: Final = Path(__file__).parents[1] / "result_methods.py"
_WIDTH: Final = 110

_HEAD: Final = '''"""A method for each result. Made by service.views.client_methods: do not edit."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from service.formats import Methods, Progress, Results

if TYPE_CHECKING:
    import xarray
'''


def source() -> str:
    """The text of the file."""
    return _HEAD + _class("ResultMethods", "a job", VIEWS) + _class("SpringMethods", "a spring", SPRINGS)


def _class(name: str, owner: str, views: dict[str, View]) -> str:
    lines = []
    for view in views.values():
        printed = view.printed or (() if view.rows is None else (view.rows,))
        lines.append(f"        {_literal(view.name)}: {_literal((view.formats, printed))},\n")
    return (
        f'\n\nclass {name}(Methods):\n    """A method for each result of {owner}."""\n\n'
        f"    RESULTS: ClassVar[Results] = {{\n{''.join(lines)}    }}\n"
        + "".join(map(_method, views.values()))
    )


def _literal(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(_literal, value))}{',' if len(value) == 1 else ''})"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _method(view: View) -> str:
    own = view.query.__annotations__  # before those of its bases
    fields = dict(sorted(view.query.model_fields.items(), key=lambda field: field[0] not in own))
    parameters = {name: _parameter(field) for name, field in fields.items()}
    if view.parts is not None:
        parameters |= {"timeout": "float = 300.0", "progress": "Progress = True"}
    declared = "".join(f"        {name}: {hint},\n" for name, hint in parameters.items())
    passed = ", ".join(f"{name}={name}" for name in parameters)
    return (
        f'\n    def {view.name}(\n        self,\n{declared}    ) -> "xarray.Dataset":\n'
        f'        """{indent(_docstring(view), " " * 8).strip()}\n        """\n'
        f'        return self.result("{view.name}", {passed})\n'
    )


def _docstring(view: View) -> str:
    units = {row.name: row.attrs.get("units", "1") for row in view.variables}
    names = ", ".join(f"`{name}`" + f" ({unit})" * (unit != "1") for name, unit in units.items())
    waits = " Waits up to `timeout` seconds for the workers, and shows `progress`." * (view.parts is not None)
    rest = (
        f"Returns a Dataset with the attribute `complete` and the variables {names}.{waits} "
        "Raises BadRequest naming the parameter, TooLarge naming what fits."
    )
    return f"{cleandoc(view.compute.__doc__ or view.summary)}\n\n{fill(rest, _WIDTH - 8)}"


def _parameter(field: FieldInfo) -> str:
    hint = _type(field.annotation) + " | Sequence[float]" * (Sequence[float] in field.metadata)
    if field.description:
        hint = f"Annotated[{hint}, {_literal(field.description)}]"
    return hint if field.is_required() else f"{hint} = {_literal(field.default)}"


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type(arguments[0])
    if origin is Literal:
        return f"Literal[{', '.join(map(_literal, arguments))}]"
    if origin in (Union, UnionType):
        return " | ".join(map(_type, arguments))
    return "None" if annotation is type(None) else str(annotation.__name__)


if __name__ == "__main__":
    FILE.write_text(source())
    sys.stdout.write(f"{FILE}\n")
