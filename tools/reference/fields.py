"""What the source says of a class's fields: the text below each of them."""

import ast
import inspect
from itertools import pairwise
from textwrap import dedent


def described(kind: type) -> dict[str, str]:
    """The description of each field of a class, its bases included. Raises KeyError for a field
    without one."""
    inherited = [described(base) for base in kind.__bases__ if "__annotations__" in vars(base)]
    texts = {name: text for base in inherited for name, text in base.items()} | _own(kind)
    for name in vars(kind).get("__annotations__", {}):
        if name not in texts:
            raise KeyError(f"{kind.__name__}.{name} has no description in {kind.__module__}")
    return texts


def _own(kind: type) -> dict[str, str]:
    """Strings that stand below a field. pydantic could read them, but at every import of a fish."""
    (defined,) = ast.parse(dedent(inspect.getsource(kind))).body
    assert isinstance(defined, ast.ClassDef)
    texts = {}
    for field, below in pairwise(defined.body):
        match field, below:
            case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                texts[name] = inspect.cleandoc(text)
    return texts


def summary(kind: type) -> str:
    """The docstring of a class."""
    return inspect.getdoc(kind) or ""
