"""A job and a model to begin with, which run as they are."""

from collections.abc import Iterator

from pfdist.common.arguments import path_argument
from pfdist.errors import ArgumentError, StoreError, shown
from pfdist.store.files import reading

JOB = """#:schema ./job.schema.json
# `pfdist schema > job.schema.json` lets an editor complete and check this file (docs/install.md).
#
# When to measure? This job and its model NAME.py run as they are; change them.
#
#   pfdist check-model NAME.toml    # after each change: is anything wrong?
#   pfdist plan NAME.toml           # when to measure, and how good that is
#   pfdist explore NAME.toml        # move the times by hand: pip install -e '.[explore]'

seed = 1

[model]
name = "NAME.py:model"

[problem]
horizon = 60                      # t = 0, 1, ..., 60
measurement_budget = 6            # so many measurements can be afforded
# estimate = "smoothed"           # all measurements are analysed afterwards, not one by one
# minimum_spacing = 3             # between two measurements
# required = [0]                  # measured in any case
# forbidden = ["20:30"]           # nobody can measure then

# A sensor that sometimes fails, or whose values arrive later (two sensors: docs/sensors.md):
# sensor = { fails = 0.1, delay = 2 }

# Dates in the place of 0, 1, ..., 60:
# clock = { start = 2027-03-01, step = "1 d" }

[filter]
particles = 300                   # "auto" finds how many are enough

[comparison]
draws = 2000                      # simulated systems that judge the plan
"""

MODEL = '''"""A value that wanders around 0, and is disturbed most near t = 35."""

import numpy as np

from pfdist import StateSpaceModel


def initial(w, p):  # w: random numbers; p: parameters
    return (w[0],)


def transition(x, t, w, p):  # from t to t + 1
    disturbance = p.calm + p.disturbed * np.exp(-(((t - 35) / 6) ** 2))
    return (p.memory * x[0] + disturbance * w[0],)


def measurement(x, t, v, p):  # what is read, with its error
    return (x[0] + p.error * v[0],)


def likelihood_of_reading(y, x, t, p):  # of the reading y, if the state is x
    return -0.5 * ((y[0] - x[0]) / p.error) ** 2 - np.log(p.error * np.sqrt(2 * np.pi))


def quantity_of_interest(x, t, p):  # what you want to know
    return (x[0],)


model = StateSpaceModel(
    name="NAME",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=likelihood_of_reading,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"memory": 0.95, "calm": 0.1, "disturbed": 1.0, "error": 0.3},
    normalised=True,
    z_names=("value",),  # with its unit: "value [m]"
)
'''


def init(name: str = "mine") -> Iterator[str]:
    """Write a job and a model that run, to begin with.

    The job ``NAME.toml`` has the usual choices as comments: dates or steps, an analysis at the
    moment or afterwards, times at which nobody can measure. Its model ``NAME.py`` has a line for
    each formula.

    Parameters
    ----------
    name : str
        Name of both files, without an ending; a folder may stand before it.
    """
    path = path_argument("name", name)
    if not path.name.replace("-", "_").isidentifier():
        raise ArgumentError(
            f"name must have letters, digits, - and _, and begin with a letter, got {shown(name)}"
        )
    files = [path.with_name(f"{path.name}{ending}") for ending in (".toml", ".py")]
    for file in files:
        if file.exists():
            raise StoreError(f"{file} exists: give another name, or remove the file")
    for file, text in zip(files, (JOB, MODEL), strict=True):
        with reading(file, "write"):
            file.write_text(text.replace("NAME", path.name), encoding="utf-8")
        yield str(file)
    yield f"`pfdist plan {files[0]}` finds when to measure"
