"""The command ``pfdist models``."""

import ast
from argparse import Namespace

from pfdist.cli.command import command
from pfdist.errors import PfdistError


@command("models", examples={"pfdist models": "Show which names a job can give as model.name"})
def models_command(options: Namespace) -> None:
    """List the models that a job can name."""
    from pfdist.models import find_model, installed_models

    names = sorted(installed_models())
    width = max(map(len, names))
    for name in names:
        try:
            docstring = ast.get_docstring(ast.parse(find_model(name).text)) or ""
        except (PfdistError, SyntaxError) as error:
            docstring = f"cannot be loaded: {error}"
        print(f"{name:{width}}  {docstring.partition(chr(10))[0]}".rstrip())
