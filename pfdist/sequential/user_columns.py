"""Names of the columns of components in tables that users bring."""

from pfdist.models import StateSpaceModel


def user_columns(kind: str, model: StateSpaceModel) -> list[list[str]]:
    """Lists of columns that a table of x or y may have: x0, x1, ..., or those with names.

    There is a second list if the model names these components.
    """
    components = model.named(kind)
    numbered = [f"{kind}{number}" for number in range(len(components))]
    named = [f"{kind}_{each.suffix}" for each in components if each.name]
    return [numbered, named] if named else [numbered]
