"""The commands: for each the function that it calls, a sentence, and examples.

The options of a command are the parameters of its function, and their help is its docstring. To add
a command, add a line here, and to `pfdist.cli.words.WORDS` the parameters whose values no other
command reads.

An answer is a path, a line, or an object with ``as_json()`` and ``_page()``;
`pfdist.cli.shown` prints it. `tests/contracts/test_command.py` and `tests/cli/test_examples.py`
test each command, and docs/commands.md is written from this table.
"""

from pfdist.common.plugins import Command, plugins

COMMANDS: dict[str, Command] = {
    "run": Command(
        "pfdist.questions.run:run",
        "Run the searches of a job and compare the found times with evenly spaced ones.",
        {
            "pfdist run jobs/quick.toml": "Run a small job; the run is in results/quick",
            "pfdist run jobs/quick.toml --pool serial --results results/serial": (
                "Run it in one process, without Ray"
            ),
            "pfdist run jobs/quick.toml --set comparison.draws=8000": (
                "Resume it with more draws in the comparison"
            ),
        },
        resumes=True,
    ),
    "plan": Command(
        "pfdist.cli.own:plan",
        "Find measurement times for a job's problem, and prove how good they are.",
        {
            "pfdist plan jobs/plan.toml": (
                "Find times, and prove how good they are; the run is in results/plan"
            ),
            "pfdist plan jobs/two_compartments.toml --set scenarios.criterion=worst": (
                "Plan for the worst of the scenarios of a job"
            ),
            "pfdist plan jobs/plan.toml --against last=0:60:4": (
                "Compare last year's times with the best plan of as many"
            ),
            "pfdist plan jobs/plan.toml --set seed=3 --results results/seed3": (
                "Change a key of the job, and keep the run in another folder"
            ),
            "pfdist plan jobs/plan.toml --set filter.particles=auto --results results/auto": (
                "First find how many particles are enough"
            ),
            "pfdist plan jobs/plan.toml --dry-run": (
                "Foresee the work of each part, and its minutes on this machine"
            ),
            "pfdist plan jobs/plan.toml --search exchange --results results/exchange": (
                "Search by another method"
            ),
        },
        resumes=True,
    ),
    "compare": Command(
        "pfdist.questions.compare:compare",
        "Compare named sets of times, and the sets of runs, on the same fresh draws.",
        {
            "pfdist compare jobs/plan.toml --times clinic=0,20,40,60 --times mine=0:60:3": (
                "Compare two hand-made sets on the same draws"
            ),
            "pfdist compare jobs/plan.toml results/plan --times a=0:20 --results results/a": (
                "Compare a set with those of a finished run"
            ),
        },
        resumes=True,
    ),
    "bound": Command(
        "pfdist.questions.bound:bound",
        "Prove how much lower the expected MSE of any other times can be.",
        {
            "pfdist bound jobs/plan.toml": "Prove a lower bound for the times of a finished run",
            "pfdist bound jobs/plan.toml --within 0.05": "Add draws until the gap is at most 5 %",
        },
        resumes=True,
    ),
    "evaluate": Command(
        "pfdist.questions.evaluate:evaluated",
        "Estimate the expected MSE of a set of measurement times, or of several.",
        {
            "pfdist evaluate jobs/plan.toml --times 0:60:3": "Measure at t = 0, 3, 6, ..., 60",
            "pfdist evaluate jobs/plan.toml --times 0,6,12,20:30 --draws 5000": (
                "Measure at 0, 6, 12 and at each instant from 20 to 30, on more draws"
            ),
            "pfdist evaluate jobs/plan.toml --times few=0:60:6 --times many=0:60:3": (
                "Evaluate two sets on the same draws"
            ),
            "pfdist evaluate jobs/plan.toml --times 0:60:3 --profile": (
                "Also estimate the expected error at each instant"
            ),
            "pfdist evaluate jobs/plan.toml --times 0:60:3 --also worst_instant": (
                "Also give the largest expected error at an instant"
            ),
        },
    ),
    "status": Command(
        "pfdist.cli.own:status",
        "Show how far a run is and what it has found.",
        {
            "pfdist status results/plan": "Show what a run has found so far",
            "pfdist status results/plan --export plan.csv": "Write the plan for a spreadsheet",
            "pfdist status results/plan --json": "Print the same as JSON, for a program",
        },
    ),
    "report": Command(
        "pfdist.questions.report:report",
        "Write the report of a run: one HTML file that can be sent to anybody.",
        {
            "pfdist report results/plan": "Write report.html into the folder of the run",
            "pfdist report results/plan --watch": "Write it again while the run continues",
        },
    ),
    "plot": Command(
        "pfdist.cli.own:plot",
        "Draw the figures of a run, or the figure of a sweep, as PNG, SVG and PDF.",
        {
            "pfdist plot results/plan": "Draw the figures of a run again",
            "pfdist plot results/budgets": "Draw the figure of a sweep",
        },
    ),
    "verify": Command(
        "pfdist.cli.own:verify",
        "Check every byte, row and key of a run.",
        {"pfdist verify results/plan": "Check a run after it was copied"},
    ),
    "models": Command(
        "pfdist.cli.own:models",
        "List the models that a job can name.",
        {"pfdist models": "Show which names a job can give as model.name"},
    ),
    "schema": Command(
        "pfdist.cli.own:schema",
        "Print the JSON schema of job files and sweep files, for an editor.",
        {"pfdist schema > job.schema.json": "Write it beside the jobs that name it"},
    ),
    "completion": Command(
        "pfdist.cli.own:completion",
        "Print a script by which a shell completes commands, options and files.",
        {
            'eval "$(pfdist completion bash)"': "Complete with Tab in this terminal",
            "pfdist completion bash > ~/.pfdist.bash": (
                "Keep the script, for the line `. ~/.pfdist.bash` in ~/.bashrc"
            ),
            "pfdist completion zsh > ~/.zfunc/_cyclopts_pfdist": (
                "Keep it for zsh, with `fpath+=~/.zfunc` before compinit in ~/.zshrc"
            ),
            "pfdist completion fish > ~/.config/fish/completions/pfdist.fish": (
                "Complete in every terminal of fish"
            ),
        },
    ),
}
"""All commands by name: those of the core, and those of plugins."""

GROUPS: dict[str, tuple[str, ...]] = {
    "Plan": ("plan", "run"),
    "Ask": ("evaluate", "compare", "bound"),
    "Real data": (),
    "Runs": ("status", "report", "plot", "verify"),
    "Models": ("models", "schema", "completion"),
}
"""The groups of the help, with their commands in order: those of plugins follow."""

for plugin in plugins().values():
    for title, added in plugin.commands.items():
        COMMANDS |= added
        GROUPS[title] = (*GROUPS.get(title, ()), *added)
COMMANDS = {name: COMMANDS[name] for group in GROUPS.values() for name in group}
