import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from scaleup.system import registry
from scaleup.system.errors import PluginError


@pytest.fixture
def entry_points(monkeypatch):
    def register(*points):
        monkeypatch.setattr(registry, "registered", lambda group, path: points)

    return register


def point(name, value):
    return EntryPoint(name, value, registry.GROUPS["flow"])


def test_names_are_listed_without_importing_any_plugin():
    program = (
        "import sys; from scaleup.system.registry import available; "
        "names = [n for k in ('geometry', 'flow', 'mixing') for n in available(k)]; "
        "assert 'drum' in names and 'lax-wendroff' in names; "
        "print([m for m in sys.modules if m.startswith('scaleup_') or m in ('mpi4py', 'ngsolve')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[]"


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(PluginError, match=r"; did you mean .drum.\?; installed are: drum"):
        registry.load("geometry", "drumm")


def test_the_same_name_twice_is_an_error(entry_points):
    entry_points(point("a", "one:A"), point("a", "two:A"))
    with pytest.raises(PluginError, match="registered twice"):
        registry.available("flow")


def test_a_plugin_that_cannot_be_imported_names_its_distribution(entry_points):
    entry_points(point("a", "no_such_module:A"))
    with pytest.raises(PluginError, match="distribution unknown cannot be imported"):
        registry.load("flow", "a")
    with pytest.warns(UserWarning, match="distribution unknown is broken"):
        registry.warn_of_broken("flow")
