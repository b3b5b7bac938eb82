"""Write the client's methods, one for each view: `python -m service.views.client_methods`.

The client and the commands read that file, since a client's installation lacks the kernel and the server, and
the commands load no client to show their help. A test compares it with the registry.
"""

import sys
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path
from textwrap import indent, wrap
from types import UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from service.views.registry import SPRINGS, VIEWS
from service.views.view import View

FILE: Final = Path(__file__).parents[1] / "result_methods.py"
_WIDTH: Final = 110

_HEAD: Final = '''"""A method for each result. Made by service.views.client_methods: do not edit."""

from abc import ABC, abstractmethod
from typing import {imports}

if TYPE_CHECKING:
{callback}    import xarray
'''
_CLASS: Final = '''

class {name}(ABC):
    """A method for each result of {of}."""

    #: The formats of each result, and the variables whose numbers are the rows of printed tables.
    FORMATS: ClassVar[dict[str, tuple[str, ...]]] = {formats}
    PRINTED: ClassVar[dict[str, tuple[str, ...]]] = {printed}

    @abstractmethod
    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name."""
'''


def source() -> str:
    """The text of the file."""
    text = _class("ResultMethods", "a job", VIEWS) + _class("SpringMethods", "a spring", SPRINGS)
    names = ("TYPE_CHECKING", "Annotated", "Any", "ClassVar", "Literal")
    used = (name for name in names if f"{name}[" in text or name in ("TYPE_CHECKING", "Any"))
    callback = "    from collections.abc import Callable\n\n" if "Callable[" in text else ""
    return _HEAD.format(imports=", ".join(used), callback=callback) + text


def _class(name: str, of: str, views: dict[str, View]) -> str:
    formats = _mapping({name: view.formats for name, view in views.items()})
    rows = {name: () if view.rows is None else (view.rows,) for name, view in views.items()}
    printed = _mapping({name: view.printed or rows[name] for name, view in views.items()})
    head = _CLASS.format(name=name, of=of, formats=formats, printed=printed)
    return head + "".join(map(_method, views.values()))


def _mapping(values: dict[str, Any]) -> str:
    lines = [f"        {_quoted(name)}: {_literal(value)},\n" for name, value in values.items()]
    return "{\n" + "".join(lines) + "    }"


def _literal(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(_literal, value))}{',' if len(value) == 1 else ''})"
    return _quoted(value) if isinstance(value, str) else repr(value)


def _quoted(text: str) -> str:
    return f'"{text}"'


def _method(view: View) -> str:
    fields = view.query.model_fields
    parameters = "".join(f"        {name}: {_parameter(field)},\n" for name, field in fields.items())
    passed = ", ".join(f"{name}={name}" for name in fields)
    if view.parts is not None:
        parameters += "        timeout: float = 300.0,\n"
        parameters += '        progress: "bool | Callable[[int, int], None]" = True,\n'
        passed += ", timeout=timeout, progress=progress"
    text = indent("\n".join(_docstring(view)), " " * 8)
    return (
        f'\n    def {view.name}(\n        self,\n{parameters}    ) -> "xarray.Dataset":\n'
        f'        """{text.strip()}\n        """\n'
        f'        return self.result("{view.name}", {passed})\n'
    )


def _docstring(view: View) -> Iterator[str]:
    yield cleandoc(view.compute.__doc__ or view.summary)
    yield "\nParameters\n----------"
    for name, field in view.query.model_fields.items():
        yield f"{name} : {_type(field.annotation)}"
        if field.description:
            yield from _wrapped(field.description)
    if view.parts is not None:
        yield "timeout : float\n    Seconds to wait for the workers."
        yield "progress : bool or callable\n    Shows the parts done, or is called with their number and all."
    yield "\nReturns\n-------\nxarray.Dataset\n    With the attribute `complete` and these variables:\n"
    for line in view.described:
        yield from _wrapped(line)
    yield "\nRaises\n------\nBadRequest\n    Names the parameter.\nTooLarge\n    Names what fits."


def _wrapped(text: str) -> list[str]:
    return wrap(text, _WIDTH - 12, initial_indent="    ", subsequent_indent="      ")


def _parameter(field: FieldInfo) -> str:
    hint = _type(field.annotation)
    if field.description:
        hint = f"Annotated[{hint}, {_quoted(field.description)}]"
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
