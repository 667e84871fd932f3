"""The command ``pfdist models``."""

from argparse import Namespace
from importlib import import_module

from pfdist.cli.command import command


@command("models", examples={"pfdist models": "Show which names a job can give as model.name"})
def models_command(options: Namespace) -> None:
    """List the models that a job can name."""
    from pfdist.models import installed_models

    models = installed_models()
    width = max(map(len, models))
    for name in sorted(models):
        try:
            description = import_module(models[name][0]).__doc__ or ""
        except Exception as error:  # a package that was installed beside pfdist
            description = f"cannot be loaded: {type(error).__name__}: {error}"
        print(f"{name:{width}}  {description.partition(chr(10))[0]}".rstrip())
