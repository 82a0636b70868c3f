"""What ships with the package: stubs that agree with the code, and documentation of everything public."""

import ast
import inspect
import pathlib

import pytest

import gloaming
from gloaming import _gloaming

HOME = pathlib.Path(gloaming.__file__).parent


def test_it_is_typed():
    assert (HOME / "py.typed").exists()


def parameters(function):
    return [a.arg for a in function.args.posonlyargs + function.args.args + function.args.kwonlyargs]


def test_stubs_say_what_the_compiled_part_has():
    stubs = ast.parse((HOME / "_gloaming.pyi").read_text())
    declared = {}
    for node in stubs.body:
        if isinstance(node, ast.FunctionDef):
            declared[node.name] = parameters(node)
        elif isinstance(node, ast.ClassDef):
            for method in node.body:
                if isinstance(method, ast.FunctionDef):
                    declared[f"{node.name}.{method.name}"] = parameters(method)
    actual = {"png": _gloaming.png}
    for name in ["Frame", "Session", "InSitu", "Series"]:
        kind = getattr(_gloaming, name)
        ours = {k: v for k, v in vars(kind).items() if k == "__new__" and name != "Frame" or not k.startswith("__")}
        actual |= {f"{name}.{member}": value for member, value in ours.items()}
    assert set(declared) == set(actual)
    for name, arguments in declared.items():
        value = actual[name]
        if not callable(value):
            continue
        if name.endswith("__new__"):
            value = getattr(_gloaming, name.split(".")[0])
            arguments = arguments[1:]
        signature = inspect.signature(value)
        assert [a for a in arguments if a != "self"] == [p for p in signature.parameters if p != "self"], name


@pytest.mark.parametrize("name", [name for name in gloaming.__all__ if name != "__version__"])
def test_everything_public_is_documented(name):
    thing = getattr(gloaming, name)
    assert inspect.getdoc(thing)
    if inspect.isclass(thing):
        for member, value in vars(thing).items():
            if not member.startswith("_") and (callable(value) or isinstance(value, property) or inspect.isgetsetdescriptor(value) or inspect.ismemberdescriptor(value)):
                assert inspect.getdoc(value), f"{name}.{member}"
