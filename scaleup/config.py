"""The run configuration: composed from layers, validated whole before anything is built.

Layers, later ones winning: the defaults here, the geometry's own default scene, the TOML file, the
command line (`--set section.key=value`, then the short flags). Tables whose keys exclude each other
(the kinds of fill and of grid) are replaced whole, and so is a table that names a plugin or a
loading pattern when a later layer names another one; all else is merged key by key.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from scaleup import registry, units
from scaleup.blame import blamed_on
from scaleup.errors import ContractError, InputError, did_you_mean, shortened, shown
from scaleup.feasibility import component_count, require_feasible
from scaleup.files import read_text
from scaleup.registry import Kind
from scaleup.scene import Diffusion, Material, Model, Operation, SmallShare
from scaleup.units import Quantity, in_likely_units, quantity_of
from scaleup.vessel_shape import Bed, level_height

PLUGIN_SECTIONS: tuple[Kind, ...] = ("geometry", "flow", "mixing")
_DEEPEST = 6  # tables within each other; no key needs as many
_EXCLUSIVE = {("operation", "fill"), ("grid",)}
_CHOICE: dict[tuple[str, ...], str] = {
    ("geometry",): "name",
    ("flow",): "name",
    ("mixing",): "name",
    ("operation", "loading"): "pattern",
}


class GridChoice(Model):
    """How fine the mixing grid is, in one of two ways."""

    spacing: units.Length | None = None
    """m, edge of a cell"""
    cells: Annotated[float, Field(ge=100, le=1e9)] | None = None
    """wanted number of active cells (those that hold material)"""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.spacing is None) == (self.cells is None):
            raise ValueError("give exactly one of spacing, cells")
        return self


class Accuracy(Model):
    """What the error estimate is and what is asked of it."""

    tolerance: SmallShare = 0.02
    """wanted error of the segregation intensity"""
    estimate: bool = True
    """repeat the mixing on cells twice as large (an eighth of the cost) to see the change"""
    blended_rsd: SmallShare = 0.05
    """relative standard deviation below which the powder counts as blended"""
    scrutiny: Annotated[float, Field(ge=1, le=1000)] = 5.0
    """scale of scrutiny: edge of a sample, in grain diameters"""
    sample_mass: units.Mass | None = None
    """kg, of a sample, in place of scrutiny"""


class Output(Model):
    """What is kept."""

    metrics_every: Annotated[float, Field(ge=1e-3, le=1)] = 0.05
    """revolutions between points of the blend curve"""
    snapshots_every: Annotated[float, Field(ge=1e-3)] = 0.5
    """revolutions between stored concentration fields"""
    animate: Literal["no", "first", "last", "both"] = "no"
    """which revolution becomes an animation (GIF): 32 pictures of it are then stored, not 8"""
    checkpoint_every: units.Pause = 20.0
    """s of wall-clock time between checkpoints, at points of the blend curve"""


class RunConfig(Model):
    """A complete run. `geometry`, `flow` and `mixing` hold `name` and that plugin's options."""

    geometry: dict[str, Any]
    material: Material = Material()
    operation: Operation = Operation()
    flow: dict[str, Any]
    diffusion: Diffusion = Diffusion()
    mixing: dict[str, Any]
    grid: GridChoice
    accuracy: Accuracy = Accuracy()
    output: Output = Output()

    @property
    def sample_edge(self) -> float:
        """Edge, m, of the samples that are asked for: cubes."""
        if self.accuracy.sample_mass is not None:
            return float((self.accuracy.sample_mass / self.material.bulk_density) ** (1 / 3))
        return self.accuracy.scrutiny * self.material.grain_diameter

    def options(self, kind: Kind) -> Any:
        """The chosen plugin's validated Options."""
        section = dict(getattr(self, kind))
        plugin = registry.load(kind, section.pop("name"))
        return plugin.Options.model_validate(section)

    def plugin(self, kind: Kind) -> Any:
        """The chosen plugin, constructed with its options."""
        name = getattr(self, kind)["name"]
        with blamed_on(kind, name):
            return registry.load(kind, name)(self.options(kind))

    def to_toml(self) -> str:
        """The whole configuration; read again it gives this same run."""
        tables: dict[str, Any] = self.model_dump(mode="json", exclude_none=True)
        for kind in PLUGIN_SECTIONS:
            options = self.options(kind).model_dump(mode="json", exclude_none=True)
            tables[kind] = {"name": getattr(self, kind)["name"], **options}
        return tomli_w.dumps(tables)


def compose(
    file: Path | None = None,
    assignments: Iterable[str] = (),
    flags: Mapping[str, Any] | None = None,
    flow_must_accept: bool = True,
) -> RunConfig:
    """Compose and validate a configuration.

    file        -- TOML
    assignments -- texts `section.key=value`; a value is read as TOML, else taken as text
    flags       -- nested tables of the command line's short flags
    flow_must_accept -- whether a flow model that refuses the vessel and speed is an error
    Raises InputError with one sentence naming key, value and rule.
    """
    assigned: dict[str, Any] = {}
    for text in assignments:
        assigned = _merged(assigned, _spelt_out(_assigned(text)), within_layer=True)
    command_line = _merged(assigned, flags or {}, within_layer=True)
    layers = [_spelt_out(_read(file)) if file else {}, command_line]
    try:
        return _composed(layers, flow_must_accept)
    except InputError as error:
        hint = _likelier(error, layers, flow_must_accept)
        if not hint:
            raise
        raise InputError(f"{error}{hint}") from None


def _composed(layers: Sequence[Mapping[str, Any]], flow_must_accept: bool) -> RunConfig:
    """The configuration of the user's layers. Raises InputError."""
    user: dict[str, Any] = {}
    for layer in layers:
        user = _merged(user, layer)
    name = _section(user, "geometry").get("name", "drum")
    geometry = registry.load("geometry", _text("geometry.name", name))
    with blamed_on("geometry", name):
        scene = _default_scene(geometry, user)
    base = _merged({"geometry": {"name": name}}, _spelt_out(scene))
    for layer in layers:
        base = _merged(base, layer)
    for kind in PLUGIN_SECTIONS:
        section = _section(base, kind)
        if "name" not in section:
            raise InputError(f"{kind}.name is missing; the geometry {name!r} has no default for it")
        registry.load(kind, _text(f"{kind}.name", section["name"]))
    config: RunConfig = _validated(RunConfig, base, "")
    for kind in PLUGIN_SECTIONS:
        section = dict(base[kind])
        plugin = registry.load(kind, section.pop("name"))
        _validated(plugin.Options, section, f"{kind}.")
    with blamed_on("geometry", config.geometry["name"]):
        require_feasible(config, bed_at_rest(config))
    _mixing_accepts(config)
    if flow_must_accept:
        flow, geometry = config.plugin("flow"), config.plugin("geometry")
        with blamed_on("flow", config.flow["name"]):
            flow.check(geometry, config.operation.speed)
            flow_cautions(config)
    return config


def _mixing_accepts(config: RunConfig) -> None:
    """Ask a mixing backend that may refuse. Raises InputError."""
    geometry, backend = config.plugin("geometry"), config.plugin("mixing")
    if hasattr(backend, "check"):
        components = component_count(config.operation.loading, geometry.dimension)
        with blamed_on("mixing", config.mixing["name"]):
            backend.check(geometry, components)


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
        user = _merged(user, layer)
    quantity = _quantity_at(user, path)
    for part in path:
        user = user.get(part) if isinstance(user, Mapping) else None
    if quantity is None or user is None:
        return ""
    for text in in_likely_units(user, quantity):
        try:
            _composed([*layers, _nested(path, text)], flow_must_accept)
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
        models = [registry.load(kind, n).Options for n in names if n in registry.available(kind)]
        path = path[1:]
    fields = [_field_at(model, path) for model in models]
    return next((_reads(field) for field in fields if field is not None), None)


def plugin_options(kind: Kind, name: str, assignments: Iterable[str]) -> Any:
    """A plugin's Options from texts `kind.key=value`. Raises InputError."""
    tables: dict[str, Any] = {}
    for text in assignments:
        tables = _merged(tables, _assigned(text), within_layer=True)
    for section in tables:
        if section != kind:
            raise InputError(f"--set {section}: only keys of {kind} can be set here")
    plugin = registry.load(kind, name)
    return _validated(plugin.Options, tables.get(kind, {}), f"{kind}.")


def _default_scene(geometry: Any, user: Mapping[str, Any]) -> Mapping[str, Any]:
    """The geometry's default scene, for the options that the user gave it."""
    scene = geometry.default_scene
    if not callable(scene):
        return dict(scene)
    options = {key: value for key, value in _section(user, "geometry").items() if key != "name"}
    return dict(scene(_validated(geometry.Options, options, "geometry.")))


def bed_at_rest(config: RunConfig) -> Bed:
    """The level bed in the vessel before it turns. Raises InputError if there can be none."""
    return Bed(config.plugin("geometry"), fill_volume(config), grid_spacing(config))


def flow_cautions(config: RunConfig) -> tuple[str, ...]:
    """What the flow model says of the scene before it is solved. Raises InputError if it refuses.

    A flow model need not have anything to say. Raises ContractError if it says no sentences.
    """
    cautions = getattr(config.plugin("flow"), "cautions", None)
    if cautions is None:
        return ()
    geometry, speed = config.plugin("geometry"), config.operation.speed
    said = cautions(geometry, config.material, speed, fill_volume(config))
    if not isinstance(said, (tuple, list)) or not all(isinstance(text, str) for text in said):
        raise ContractError(f"cautions must return a tuple of sentences, not {shown(said)}")
    return tuple(said)


def fill_volume(config: RunConfig) -> float:
    """The bed's volume, m^3. Raises InputError if the vessel cannot hold it."""
    geometry, fill = config.plugin("geometry"), config.operation.fill
    if fill.depth_ratio is not None:
        bottom, top = geometry.lower[1], geometry.upper[1]
        return float(geometry.volume_below(bottom + fill.depth_ratio * (top - bottom)))
    if fill.volume_fraction is not None:
        return float(fill.volume_fraction * geometry.volume)
    assert fill.mass is not None  # the model's validator has seen to it
    volume = fill.mass / config.material.bulk_density
    if volume >= geometry.volume:
        most = geometry.volume * config.material.bulk_density
        raise InputError(f"operation.fill.mass = {fill.mass:g} kg: the vessel holds {most:.4g} kg")
    return volume


def fill_in_all_kinds(config: RunConfig) -> dict[str, float]:
    """The fill as depth ratio, volume fraction and mass (kg), whichever was given."""
    geometry, volume = config.plugin("geometry"), fill_volume(config)
    bottom, top = geometry.lower[1], geometry.upper[1]
    return {
        "depth_ratio": (level_height(geometry, volume) - bottom) / (top - bottom),
        "volume_fraction": volume / geometry.volume,
        "mass": volume * config.material.bulk_density,
    }


def grid_spacing(config: RunConfig) -> float:
    """Edge of a cell, m; from the wanted number of active cells if that was given."""
    if config.grid.spacing is not None:
        return config.grid.spacing
    assert config.grid.cells is not None  # the model's validator has seen to it
    geometry = config.plugin("geometry")
    if geometry.dimension == 2:
        return math.sqrt(fill_volume(config) / geometry.depth / config.grid.cells)
    return float((fill_volume(config) / config.grid.cells) ** (1 / 3))


def _read(file: Path) -> dict[str, Any]:
    try:
        tables = tomllib.loads(read_text(file))
    except OSError as error:
        raise InputError(f"the configuration {file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise InputError(
            f"the configuration {file} is no text in UTF-8 (byte 0x{byte:02x} at {error.start}); "
            "save it as UTF-8"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"the configuration {file} is not TOML: {error}") from error
    _require_shallow(tables, f"the configuration {file}")
    return tables


def _require_shallow(value: Any, what: str) -> None:
    level: list[Any] = [value]
    for _ in range(_DEEPEST):
        inner = [i.values() if isinstance(i, Mapping) else i for i in level]
        level = [x for i in inner for x in i if isinstance(x, Mapping | list)]
    if level:
        raise InputError(f"{what} holds tables more than {_DEEPEST} deep; no key is")


def _spelt_out(layer: Mapping[str, Any]) -> dict[str, Any]:
    """The layer with `loading = "name"` written as the table it stands for."""
    operation = layer.get("operation")
    if isinstance(operation, Mapping) and isinstance(operation.get("loading"), str):
        return {**layer, "operation": {**operation, "loading": {"pattern": operation["loading"]}}}
    return dict(layer)


def _assigned(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    path = key.strip().split(".")
    if not equals or not 2 <= len(path) <= _DEEPEST or not all(path):
        raise InputError(f"--set {shown(text)}: write it as section.key=value")
    try:
        table = tomllib.loads(f"value = {value}")
        parsed: Any = table["value"] if len(table) == 1 else value.strip()
    except (ValueError, RecursionError):
        parsed = value.strip()
    _require_shallow([parsed], f"--set {shown(text)}")
    return _nested(path, parsed)


def _nested(path: Sequence[str], value: Any) -> dict[str, Any]:
    for part in reversed(path):
        value = {part: value}
    return dict(value)


def _merged(
    base: Mapping[str, Any],
    over: Mapping[str, Any],
    path: tuple[str, ...] = (),
    within_layer: bool = False,
) -> dict[str, Any]:
    result = dict(base)
    for key, value in over.items():
        here, old = (*path, key), result.get(key)
        merge = isinstance(value, Mapping) and isinstance(old, Mapping)
        if merge and (within_layer or not _replaces(here, old or {}, value)):
            value = _merged(old or {}, value, here, within_layer)
        result[key] = value
    return result


def _replaces(path: tuple[str, ...], old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    choice = _CHOICE.get(path)
    return path in _EXCLUSIVE or (
        choice is not None and new.get(choice, old.get(choice)) != old.get(choice)
    )


def _section(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = tables.get(name, {})
    if not isinstance(section, Mapping):
        raise InputError(f"{name} = {shown(section)}: must be a table with a name")
    return section


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise InputError(f"{key} = {shown(value)}: must be a text")
    return value


def _validated(model: type[Any], data: Mapping[str, Any], prefix: str) -> Any:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(_sentence(error, prefix, model)) from None
    except OSError as error:  # a file's name that the system cannot even look up
        key = prefix + ".".join(_path_to(str(error.filename), data) or ["file"])
        raise InputError(f"{key} = {shown(error.filename)}: {error.strerror}") from None


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
        field, limit = _field_at(model, path), first["ctx"][name]
        quantity = None if field is None else _reads(field)
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


def _field_at(model: Any, path: Sequence[str]) -> FieldInfo | None:
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


def _reads(field: FieldInfo) -> Quantity | None:
    """The quantity that a field reads, if it is one."""
    found = (quantity_of(part) for part in (*field.metadata, field.annotation))
    return next((each for each in found if each is not None), None)


def _known_keys(model: type[Any], path: Sequence[str]) -> list[str]:
    field = _field_at(model, path) if path else None
    inner = model if field is None and not path else getattr(field, "annotation", None)
    return list(getattr(inner, "model_fields", ()))
