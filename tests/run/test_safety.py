"""No command is put together as text, and no file is opened in a way that may run code in it."""

import ast
import pickle
import re
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.prior.load import load_prior

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(
    file
    for folder in ("pipeline", "stages", "benchmarks", "examples")
    for file in (ROOT / folder).rglob("*.py")
)


def calls(file: Path):
    """(line, dotted name, keyword arguments) of every call in a file."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            yield node.lineno, ast.unparse(node.func), {k.arg: k.value for k in node.keywords}


def is_true(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Constant) and value.value is True


def unsafe(file: Path) -> list[str]:
    """What a file does that may run a command or code out of data."""
    found = []
    for line, name, keywords in calls(file):
        wrong = (
            name in ("os.system", "os.popen", "eval", "exec", "yaml.load", "yaml.unsafe_load")
            or name.startswith(("subprocess.getoutput", "subprocess.getstatusoutput"))
            or ("shell" in keywords and not isinstance(keywords["shell"], ast.Constant))
            or is_true(keywords.get("shell"))
            or ("allow_pickle" in keywords)
            or (name == "torch.load" and not is_true(keywords.get("weights_only")))
        )
        if wrong:
            found.append(f"{file.relative_to(ROOT) if file.is_relative_to(ROOT) else file}:{line}")
    text = file.read_text(encoding="utf-8")
    if re.search(r"^\s*(import|from) (pickle|dill|joblib|shelve|marshal)\b", text, re.MULTILINE):
        found.append(f"{file}: pickle")
    return found


def test_no_source_file_does_unsafe_things():
    assert len(SOURCES) > 60
    assert [line for file in SOURCES for line in unsafe(file)] == []


@pytest.mark.parametrize(
    "line",
    [
        "subprocess.run(x, shell=True)",
        "subprocess.run(x, shell=yes)",
        "os.system(x)",
        "torch.load(x)",
        "torch.load(x, weights_only=False)",
        "np.load(x, allow_pickle=True)",
        "import pickle",
        "yaml.load(x)",
    ],
)
def test_each_unsafe_thing_would_be_found(tmp_path, line):
    (tmp_path / "m.py").write_text(line)
    assert len(unsafe(tmp_path / "m.py")) == 1


class Bomb:
    """Leaves a file where it is unpickled."""

    def __init__(self, file: Path):
        self.file = file

    def __reduce__(self):
        return Path.touch, (self.file,)


@pytest.mark.parametrize("name", ["prior.safetensors", "prior.pt", "prior.npz"])
def test_a_pickle_is_no_prior_and_is_not_opened(tmp_path, name):
    (tmp_path / name).write_bytes(pickle.dumps(Bomb(tmp_path / "exploded")))
    with pytest.raises(InputError):
        load_prior(str(tmp_path / name))
    assert not (tmp_path / "exploded").exists()

    pickle.loads((tmp_path / name).read_bytes())
    assert (tmp_path / "exploded").exists()  # the bomb is one
