"""YAML as specifications need it: numbers, text, lists and mappings of YAML 1.2 only.

PyYAML reads YAML 1.1, in which 1e-3 is text, 010 is eight and no is false; and it expands aliases, so that a
short text can become a long list.
"""

import re
from collections.abc import Callable

from yaml import MappingNode, Node, ScalarNode, YAMLError
from yaml.composer import Composer
from yaml.constructor import ConstructorError, SafeConstructor
from yaml.events import AliasEvent
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

__all__ = ["YAMLError", "load"]


class _Loader(Reader, Scanner, Parser, Composer, SafeConstructor, BaseResolver):
    def __init__(self, text: str, whole: Callable[[str], int]) -> None:
        self.whole = whole
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        SafeConstructor.__init__(self)
        BaseResolver.__init__(self)

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        """PyYAML's, without aliases."""
        if self.check_event(AliasEvent):
            raise ConstructorError(None, None, "aliases are not read; write the value twice", self.get_mark())
        return super().compose_node(parent, index)

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[object, object]:
        """PyYAML's, refusing repeated keys."""
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, ScalarNode) and key.value in seen:
                raise ConstructorError(
                    None, None, f"field {key.value!r:.80} is given twice; give it once", key.start_mark
                )
            seen.add(str(key.value))
        return super().construct_mapping(node, deep)

    def construct_whole(self, node: ScalarNode) -> int:
        """A decimal number."""
        return self.whole(str(self.construct_scalar(node)))


_Loader.add_implicit_resolver("tag:yaml.org,2002:null", re.compile(r"^(?:~|null|)$"), ["~", "n", ""])
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"^(?:true|false)$"), ["t", "f"])
_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$"),
    list("-+.0123456789"),
)

_Loader.yaml_constructors = {**_Loader.yaml_constructors, "tag:yaml.org,2002:int": _Loader.construct_whole}


def load(text: str, whole: Callable[[str], int]) -> object:
    """The only document of the text; `whole` reads whole numbers. Raises YAMLError, or as `whole`."""
    loader = _Loader(text, whole)
    try:
        node = loader.get_single_node()
        return None if node is None else loader.construct_document(node)
    finally:
        loader.dispose()
