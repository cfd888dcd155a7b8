"""YAML as data and nothing else, read without trusting it: flat, small, each key once.

Values are made from the parser's events, one by one, so that nothing is composed by recursion: the
C composer of libyaml ends the interpreter where brackets are nested deeply.
"""

from typing import Any

import yaml

from imgloc.errors import ImglocError

_DEPTH, _DIGITS, _SHOWN = 8, 300, 60
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast where libyaml is
_INT = "tag:yaml.org,2002:int"
_TOO_DEEP = f"nested too deeply, expected at most {_DEPTH} levels"


def plain_yaml(text: str, name: str, error: type[ImglocError], *, most: int) -> Any:
    """Return the value of a YAML document: None, numbers, words, lists, and dicts of them.

    Anchors, aliases, tags, merge keys, a key given twice, a second document and integers of more
    than 300 digits are refused, as is what is nested more than 8 deep: nothing that imgloc reads
    needs them, and they make more of a text than it shows.

    Parameters
    ----------
    text : str
        The document.
    name : str
        Name of the file, for messages, which name the line, too.
    error : type
        Raised if it is not YAML, or not plain.
    most : int
        How many values and keys the document may hold.

    Examples
    --------
    >>> plain_yaml("a: [1, .5, x]", "a.yaml", ImglocError, most=10)
    {'a': [1, 0.5, 'x']}
    """
    try:
        return _value(_LOADER(text), name, error, most)
    except yaml.MarkedYAMLError as e:
        line = f" line {e.problem_mark.line + 1}:" if e.problem_mark else ""
        # PyYAML 6.0.4 and later read ahead, and refuse a depth of thousands before the event comes.
        deep = "nesting depth" in str(e.problem)
        said = _TOO_DEEP if deep else f"not valid YAML: {e.problem}"
        raise error(f"{name}:{line} {said}") from None
    except (yaml.YAMLError, ValueError, OverflowError) as e:
        said = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise error(f"{name}: not valid YAML: {said}") from None


def _value(loader: Any, name: str, error: type[ImglocError], most: int) -> Any:
    """Value that the events of a document make."""
    root: list[Any] = []
    within: list[Any] = [root]  # the lists and dicts that are open
    keys: list[Any] = []  # of the open dicts, that which waits for its value; `root` for none
    count = 0
    while loader.check_event():
        event = loader.get_event()
        where = f"{name}: line {event.start_mark.line + 1}"
        if isinstance(event, yaml.CollectionEndEvent):
            if isinstance(within.pop(), dict):
                keys.pop()
        elif isinstance(event, yaml.NodeEvent):
            count += 1
            if count > most:
                raise error(f"{where}: too many values, expected at most {most:,}")
            holder = within[-1]
            is_key = isinstance(holder, dict) and keys[-1] is root
            wrong = _unwanted(loader, event, is_key)
            if root and holder is root:
                wrong = "a second document"
            if not wrong:
                value = _made(loader, event)
                if is_key and value in holder:
                    wrong = f"{str(value)[:_SHOWN]}: given more than once"
            if wrong:
                raise error(f"{where}: {wrong}, expected plain values")
            if is_key:
                keys[-1] = value
                continue
            if isinstance(holder, dict):
                holder[keys[-1]], keys[-1] = value, root
            else:
                holder.append(value)
            if isinstance(event, yaml.CollectionStartEvent):
                within.append(value)
                if isinstance(value, dict):
                    keys.append(root)
                if len(within) > _DEPTH + 1:
                    raise error(f"{where}: {_TOO_DEEP}")
    return root[0] if root else None


def _made(loader: Any, event: Any) -> Any:
    """The value of a scalar, else an empty dict or list."""
    if isinstance(event, yaml.CollectionStartEvent):
        return {} if isinstance(event, yaml.MappingStartEvent) else []
    tag = loader.resolve(yaml.ScalarNode, event.value, event.implicit)
    value = loader.construct_object(yaml.ScalarNode(tag, event.value, event.start_mark))
    loader.constructed_objects.clear()
    return value


def _unwanted(loader: Any, event: Any, is_key: bool) -> str:
    """Reason why a value is not plain: mostly, that it stands for another one."""
    if event.anchor:
        kind = "alias *" if isinstance(event, yaml.AliasEvent) else "anchor &"
        return f"YAML {kind}{event.anchor[:_SHOWN]}"
    if event.tag:
        return f"YAML tag {event.tag[:_SHOWN]}"
    if isinstance(event, yaml.CollectionStartEvent):
        return "a key that is a list or a mapping" if is_key else ""
    if event.value == "<<":
        return "merge key <<"
    long = len(event.value) > _DIGITS
    if long and loader.resolve(yaml.ScalarNode, event.value, event.implicit) == _INT:
        return f"an integer of {len(event.value):,} digits"
    return ""
