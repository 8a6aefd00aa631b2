"""Tables validated by pydantic's models; what it finds is said in one sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic.fields import FieldInfo

from scaleup.case.forms import about_form, form_with, forms_of
from scaleup.scene.units import Quantity, quantity_of
from scaleup.system.errors import InputError, did_you_mean, shortened, shown


def validated(model: type[Any], data: Mapping[str, Any], prefix: str) -> Any:
    """The model of a table whose keys begin with `prefix`. Raises InputError: key = value: rule."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(_sentence(error, prefix, model)) from None
    except OSError as error:  # a file's name that the system cannot even look up
        key = prefix + ".".join(_path_to(str(error.filename), data) or ["file"])
        raise InputError(f"{key} = {shown(error.filename)}: {error.strerror}") from None


def validated_options(plugin: Any, form: str, given: Mapping[str, Any], kind: str) -> Any:
    """A plugin's Options in one of its forms. Raises InputError: key = value: rule."""
    model = forms_of(plugin).get(form, plugin.Options)
    for key in given.keys() - model.model_fields.keys():
        other = form_with(plugin, key)
        if other is not None:
            raise InputError(
                f"{kind}.{key} = {shown(given[key])}: belongs to the form {other!r} "
                f"({about_form(plugin, other)}), and this scene takes the form {form!r}"
            )
    return validated(model, given, f"{kind}.")


def _path_to(value: Any, tables: Any) -> list[str] | None:
    """The keys under which a value is found in nested tables."""
    if isinstance(tables, Mapping):
        for key, inner in tables.items():
            found = [] if inner == value else _path_to(value, inner)
            if found is not None:
                return [key, *found]
    return None


_BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


_KINDS = {
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "path_type": "the name of a file",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
}


def _sentence(error: ValidationError, prefix: str, model: type[Any]) -> str:
    """The first of pydantic's findings as one sentence: key = value: rule."""
    findings = error.errors()
    first = findings[0]
    path = [str(part) for part in first["loc"]]
    if first["type"] == "extra_forbidden":
        known = _known_keys(model, path[:-1])
        rule = "unknown key" + (did_you_mean(path[-1], known) if known else "")
        if known and "did you mean" not in rule:
            rule += f"; known here: {', '.join(known)}"
    elif first["type"] in _BOUNDS:
        name, words = _BOUNDS[first["type"]]
        field, limit = field_at(model, path), first["ctx"][name]
        quantity = None if field is None else quantity_read(field)
        rule = f"must be {words} {quantity.shown(limit) if quantity and limit else f'{limit:g}'}"
    elif first["type"] in _KINDS:
        rule = f"must be {_KINDS[first['type']]}"
    else:
        rule = first["msg"].removeprefix("Value error, ")
        rule = (rule[:1].lower() + rule[1:]).replace("input should be", "must be")
    value = first["input"]
    tell = first["type"] != "missing" and (not isinstance(value, Mapping) or len(value) <= 3)
    key = prefix + ".".join(shortened(part, 40) for part in path)
    more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
    return f"{key.rstrip('.')}{f' = {shown(value)}' if tell else ''}: {rule}{more}"


def field_at(model: Any, path: Sequence[str]) -> FieldInfo | None:
    """The field at a path of keys, which may end in numbers of a list's entries."""
    field: FieldInfo | None = None
    for part in path:
        if not hasattr(model, "model_fields"):
            return field if part.isdigit() else None
        field = model.model_fields.get(part)
        if field is None:
            return None
        model = field.annotation
    return field


def quantity_read(field: FieldInfo) -> Quantity | None:
    """The quantity that a field reads, if it is one."""
    found = (quantity_of(part) for part in (*field.metadata, field.annotation))
    return next((each for each in found if each is not None), None)


def _known_keys(model: type[Any], path: Sequence[str]) -> list[str]:
    field = field_at(model, path) if path else None
    inner = model if field is None and not path else getattr(field, "annotation", None)
    return list(getattr(inner, "model_fields", ()))
