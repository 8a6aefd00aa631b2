"""Options of plugins that take one of several forms, whose keys exclude each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic.fields import FieldInfo

from scaleup.contract import PluginOptions


def forms_of(plugin: Any) -> Mapping[str, type[PluginOptions]]:
    """The Options of each form; of a plugin that has none, its Options under an empty name."""
    return getattr(plugin, "forms", None) or {"": plugin.Options}


def form_with(plugin: Any, key: str) -> str | None:
    """The first form that has a key, if any has."""
    forms = forms_of(plugin).items()
    return next((name for name, options in forms if key in options.model_fields), None)


def about_form(plugin: Any, name: str) -> str:
    """What a form is for: the first line of its docstring."""
    text = (forms_of(plugin)[name].__doc__ or name).strip().partition("\n")[0].rstrip(".")
    return text[:1].lower() + text[1:]


def options_by_form(plugin: Any) -> Iterator[tuple[str, Mapping[str, FieldInfo]]]:
    """A title and the fields: of the options that all forms have, then of each form's own."""
    shared = plugin.Options.model_fields
    yield "options:", shared
    for name, options in forms_of(plugin).items():
        own = {key: field for key, field in options.model_fields.items() if key not in shared}
        if own:
            yield f"options of the form {name!r} ({about_form(plugin, name)}):", own
