"""A program: mutated vessel files, read one after the other in one process.

`python fuzz_vessel_files.py FOLDER COUNT SEED FORMAT...` writes and reads about COUNT files of each
format and prints, for each, "sound" or "refused". Whatever else happens is a fault, and leaves the
file in FOLDER.
"""

import itertools
import math
import sys
from functools import partial
from pathlib import Path

import meshio
import numpy as np
import trimesh
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from netgen.occ import Box, Pnt

from scaleup.contract import InputError
from scaleup_mesh import Mesh

ODD = ("nan", "inf", "-1e300", "1e-300", "4000000000", "-1", "", "0", "\u00e4", "1,5", "9" * 400)


def sources(folder):
    """Makers of sound files by the name of their format."""
    ball = trimesh.creation.icosphere(1, 0.1)
    cells = meshio.Mesh(
        np.array([*np.ndindex(2, 2, 2), (0.5, 0.5, 2.0)], dtype=float),
        [("hexahedron", [[0, 4, 6, 2, 1, 5, 7, 3]]), ("pyramid", [[1, 5, 7, 3, 8]])],
    )

    def surface(kind, **options):
        content = ball.export(file_type=kind, **options)
        return content if isinstance(content, bytes) else content.encode()

    def volume(name, **options):
        cells.write(folder / name, **options)
        return (folder / name).read_bytes()

    def solid():
        Box(Pnt(0, 0, 0), Pnt(200, 10, 15)).WriteStep(str(folder / "source.step"))
        return (folder / "source.step").read_bytes()

    return {
        "stl": partial(surface, "stl"),
        "stl_ascii": partial(surface, "stl_ascii"),
        "obj": partial(surface, "obj"),
        "off": partial(surface, "off"),
        "ply": partial(surface, "ply"),
        "ply_ascii": partial(surface, "ply", encoding="ascii"),
        "vtk": partial(volume, "source.vtk", binary=False),
        "vtk_binary": partial(volume, "source.vtk"),
        "vtu": partial(volume, "source.vtu", binary=False),
        "vtu_binary": partial(volume, "source.vtu"),
        "msh": partial(volume, "source.msh", file_format="gmsh22", binary=False),
        "msh_binary": partial(volume, "source.msh", file_format="gmsh22"),
        "step": solid,
    }


@st.composite
def mutated(draw, content):
    """The content with a few mutations, each of which a damaged file may have."""
    for _ in range(draw(st.integers(1, 3))):
        size = max(len(content), 1)
        at = draw(st.integers(0, size - 1))
        length = draw(st.integers(0, 60))
        kind = draw(st.sampled_from(("cut", "flip", "drop", "repeat", "odd", "count", "noise")))
        if kind == "cut":
            content = content[:at]
        elif kind == "flip":
            bit = bytes([content[at] ^ (1 << draw(st.integers(0, 7)))]) if content else b""
            content = content[:at] + bit + content[at + 1 :]
        elif kind == "drop":
            content = content[:at] + content[at + length :]
        elif kind == "repeat":
            content = content[: at + length] + content[at:]
        elif kind == "odd":  # a number of the text replaced
            words = content[at:].split(b" ", 2)
            if len(words) == 3:
                odd = draw(st.sampled_from(ODD)).encode("latin-1")
                content = content[:at] + b" ".join((words[0], odd, words[2]))
        elif kind == "count":  # a four-byte number or float replaced
            number = draw(st.sampled_from((b"\xff\xff\xff\xee", b"\x00\x00\xc0\x7f", bytes(4))))
            content = content[:at] + number + content[at + 4 :]
        else:
            content = content[:at] + draw(st.binary(max_size=80)) + content[at + length :]
    return content


def outcome(file):
    """ "refused" in one sentence, or "sound": then its volume and distances are finite."""
    try:
        shape = Mesh(Mesh.Options(file=file, unit="mm" if file.suffix == ".step" else "m"))
    except InputError as error:
        sentence = str(error)
        assert sentence.startswith("geometry.file = "), sentence
        assert "\n" not in sentence
        assert len(sentence) < 1000, sentence
        return "refused"
    assert shape.volume > 0
    assert math.isfinite(shape.volume)
    points = np.random.default_rng(0).uniform(shape.lower, shape.upper, (50, 3))
    assert np.isfinite(shape.signed_distance(points)).all()
    return "sound"


def main(folder, count, number, formats):
    numbers = itertools.count()
    sound = {kind: make() for kind, make in sources(folder).items() if kind in (formats or {kind})}

    @seed(number)
    @settings(
        max_examples=count * len(sound),
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(
        st.sampled_from(sorted(sound)).flatmap(lambda k: st.tuples(st.just(k), mutated(sound[k])))
    )
    def run(example):
        kind, content = example
        file = folder / f"{next(numbers)}.{kind.split('_')[0]}"  # none is read from a cache
        file.write_bytes(content)
        print(kind, outcome(file), flush=True)
        file.unlink()

    run()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4:])
