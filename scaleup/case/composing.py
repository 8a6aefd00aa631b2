"""The run configuration: composed from layers, validated whole before anything is built.

Layers, later ones winning: the defaults here, the geometry's own default scene, the TOML file, the
command line (`--set section.key=value`, then the short flags). Tables whose keys exclude each other
(the kinds of fill and of grid) are replaced whole, and so is a table that names a plugin or a
loading pattern when a later layer names another one; all else is merged key by key.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scaleup.case.case import Case
from scaleup.case.config import PLUGIN_SECTIONS, RunConfig
from scaleup.case.feasibility import component_count, require_feasible
from scaleup.case.forms import forms_of
from scaleup.case.layers import assigned, merged, nested, read_layer, spelt_out
from scaleup.case.validating import field_at, quantity_read, validated, validated_options
from scaleup.scene.laws import require_solved
from scaleup.scene.units import Quantity, in_likely_units
from scaleup.system import registry
from scaleup.system.blame import blamed_on
from scaleup.system.errors import InputError, shown
from scaleup.system.registry import Kind


def compose(
    file: Path | None = None,
    assignments: Iterable[str] = (),
    flags: Mapping[str, Any] | None = None,
    flow_must_accept: bool = True,
) -> Case:
    """Compose and validate a configuration, and resolve it.

    file        -- TOML
    assignments -- texts `section.key=value`; a value is read as TOML, else taken as text
    flags       -- nested tables of the command line's short flags
    flow_must_accept -- whether a flow model that refuses the vessel and speed is an error
    Raises InputError with one sentence naming key, value and rule.

    >>> case = compose(None, ["operation.speed=8 rpm"], {"geometry": {"name": "drum"}})
    >>> round(case.operation.speed, 4)  # rad/s
    0.8378
    >>> compose(None, ["material.wall_friction=-1"])
    Traceback (most recent call last):
        ...
    scaleup.system.errors.InputError: material.wall_friction = -1: must be at least 0
    """
    tables: dict[str, Any] = {}
    for text in assignments:
        tables = merged(tables, spelt_out(assigned(text)), within_layer=True)
    command_line = merged(tables, flags or {}, within_layer=True)
    layers = [spelt_out(read_layer(file)) if file else {}, command_line]
    try:
        return _composed(layers, flow_must_accept)
    except InputError as error:
        hint = _likelier(error, layers, flow_must_accept)
        if not hint:
            raise
        raise InputError(f"{error}{hint}") from None


def _composed(layers: Sequence[Mapping[str, Any]], flow_must_accept: bool) -> Case:
    """The case of the user's layers. Raises InputError."""
    user: dict[str, Any] = {}
    for layer in layers:
        user = merged(user, layer)
    name = _section(user, "geometry").get("name", "drum")
    geometry = registry.load("geometry", _text("geometry.name", name))
    with blamed_on("geometry", name):
        scene = _default_scene(geometry, user)
    base = merged({"geometry": {"name": name}}, spelt_out(scene))
    for layer in layers:
        base = merged(base, layer)
    for kind in PLUGIN_SECTIONS:
        section = _section(base, kind)
        if "name" not in section:
            raise InputError(f"{kind}.name is missing; the geometry {name!r} has no default for it")
        registry.load(kind, _text(f"{kind}.name", section["name"]))
    case = Case(validated(RunConfig, base, ""))
    for kind in PLUGIN_SECTIONS:
        case.options(kind)  # they may be refused
    with blamed_on("geometry", case.name("geometry")):
        require_feasible(case)
    _mixing_accepts(case)
    if flow_must_accept:
        with blamed_on("flow", case.name("flow")):
            case.flow.check(case.geometry, case.operation.speed)
            _ = case.flow_cautions  # they may refuse
    return case


def _mixing_accepts(case: Case) -> None:
    """The mixing backend solves the laws, and does not refuse. Raises InputError."""
    components = component_count(case.operation.loading, case.geometry.dimension)
    backend, name = case.new_mixing(), case.name("mixing")
    with blamed_on("mixing", name):
        require_solved(case.laws(), backend.laws, name)
        backend.check(case.geometry, components)


def _likelier(
    error: InputError, layers: Sequence[Mapping[str, Any]], flow_must_accept: bool
) -> str:
    """What a bare number was likely meant to be: the same in a unit with which it is accepted."""
    named = re.match(r"([a-z_]+(?:\.\w+)+) = ", str(error))
    if named is None:
        return ""
    path = named[1].split(".")
    user: Any = {}
    for layer in layers:
        user = merged(user, layer)
    quantity = _quantity_at(user, path)
    for part in path:
        user = user.get(part) if isinstance(user, Mapping) else None
    if quantity is None or user is None:
        return ""
    for text in in_likely_units(user, quantity):
        try:
            _composed([*layers, nested(path, text)], flow_must_accept)
        except InputError as other:
            if str(other).startswith(named[0]):
                continue
        return f'; did you mean "{text}"?'
    return ""


def _quantity_at(user: Mapping[str, Any], path: Sequence[str]) -> Quantity | None:
    """The quantity that is read at a key, if it is one; of a plugin that is not named, of any."""
    models: list[Any] = [RunConfig]
    if path[0] in PLUGIN_SECTIONS:
        kind: Kind = path[0]  # type: ignore[assignment]
        names = [_section(user, kind).get("name"), *registry.available(kind)]
        plugins = [registry.load(kind, n) for n in names if n in registry.available(kind)]
        models = [form for plugin in plugins for form in forms_of(plugin).values()]
        path = path[1:]
    fields = [field_at(model, path) for model in models]
    return next((quantity_read(field) for field in fields if field is not None), None)


def plugin_options(kind: Kind, name: str, assignments: Iterable[str]) -> Any:
    """A plugin's Options from texts `kind.key=value`. Raises InputError."""
    tables: dict[str, Any] = {}
    for text in assignments:
        tables = merged(tables, assigned(text), within_layer=True)
    for section in tables:
        if section != kind:
            raise InputError(f"--set {section}: only keys of {kind} can be set here")
    return validated_options(registry.load(kind, name), "", tables.get(kind, {}), kind)


def _default_scene(geometry: Any, user: Mapping[str, Any]) -> Mapping[str, Any]:
    """The geometry's default scene, for the options that the user gave it."""
    scene = geometry.default_scene
    if not callable(scene):
        return dict(scene)
    options = {key: value for key, value in _section(user, "geometry").items() if key != "name"}
    return dict(scene(validated_options(geometry, "", options, "geometry")))


def _section(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = tables.get(name, {})
    if not isinstance(section, Mapping):
        raise InputError(f"{name} = {shown(section)}: must be a table with a name")
    return section


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{key} = {shown(value)}: must be a text")
    return value
