"""A paragraph about the methods of a run, for a proposal or a paper."""

from collections.abc import Iterable, Iterator

from pfdist.common.parts import Section, Text
from pfdist.filters.engines import is_exact
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import PROPOSALS
from pfdist.questions.subject import Subject, number_of, without_folder
from pfdist.results.columns import Row
from pfdist.results.stored_run import about_of, evaluations_of, problem_of, version_of
from pfdist.store import run_key

_PAPER = "Aspeel et al., ICIP 2020, doi:10.1109/ICIP40778.2020.9190702"
_FRESH = "that took no part in the search"
_AS_FAR_AS = "No real measurement was used: all numbers hold as far as the model is right."


def methods_section(subject: Subject, row: Row, at: str, found: Iterable[str]) -> Section:
    """The methods and the result, with their numbers.

    Parameters
    ----------
    subject : Subject
    row : Row
        The set of the answer.
    at : str
        When it measures, in words.
    found : iterable of str
        The sentences of the answer about its gain and its proof; empty ones are left out.
    """
    text = " ".join(filter(None, [*_sentences(subject, row, at), *found, _AS_FAR_AS]))
    return Section("A methods paragraph", [Text(text)], folded=True)


def _sentences(subject: Subject, row: Row, at: str) -> Iterator[str]:
    run, problem, job = subject.run, problem_of(subject.run), subject.run.job
    z = ", ".join(each.name for each in subject.quantities if each.name) or "z"
    between = problem.clock.listed([problem.clock.times[k] for k in (0, -1)], " to ")
    yield (
        f"We looked for the measurement times that give {subject.criterion.aim(z)}"
        f"{subject.of_the_estimate} with pfdist {version_of(run)} ({_PAPER}; kernel "
        f"{about_of(run)['kernel']}, run {str(run_key(run.path))[:12]}, seed {job['seed']})."
    )
    scenarios = " with uncertain parameters" * bool(job.get("scenarios"))
    yield (
        f"Systems were simulated by the model {without_folder(job['model']['name'])}{scenarios}, "
        f"at {problem.clock.horizon + 1} instants from t = {between}."
    )
    yield _filter(subject)
    searches = ", ".join(each["method"] for each in job["search"])
    if searches:
        yield f"The search ({searches}) estimated {evaluations_of(run):,} errors of sets."
    draws = number_of(run.draws_compared, "simulated system")
    sets, fresh = len(subject.distinct), f" {_FRESH}" * bool(searches)
    compared = f"{sets} sets were compared, with common random numbers,"
    yield f"Then {compared if sets > 1 else 'the set was judged'} on {draws}{fresh}."
    best = "The best" if sets > 1 else "It"
    yield f"{best} has {number_of(row.measurements, 'measurement')}, {at}"


def _filter(subject: Subject) -> str:
    job = subject.run.job
    filtering = job["filter"]
    proposal = PROPOSALS.get(filtering.get("proposal", ""), PLAIN)
    number = filtering["moved_particles" if proposal.moves else "particles"]
    what = proposal.described.format(number_of(number, "particle"))
    if is_exact(filtering["engine"]):
        what = "the Kalman filter, whose errors are exact"
    is_wrong = any(job["model"].get("filter", {}).values())
    other = ", whose model differs from that of the truth" * is_wrong
    return f"The estimate is that of {what}{other}."
