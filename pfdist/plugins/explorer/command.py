"""The command `explore`."""

from collections.abc import Iterator

from pfdist.common.arguments import path_argument


def explore(job: str, *, port: int = 0, browser: bool = True) -> Iterator[str]:
    """Move the measurements by hand in a local page, and see the error at once.

    The page answers this machine alone, at an address that is printed, and ends with the command:
    press Ctrl-C. Whoever has the address can ask, so show it to nobody. Needs
    pip install -e '.[explore]'.

    Parameters
    ----------
    job : str
        A job file, or the folder of a run, whose plan is shown, too.
    port : int
        Port of the page; 0 for any that is free.
    browser : bool
        Whether the page is opened in the browser.
    """
    path_argument("job", job)  # before it turns out what is not installed
    from pfdist.plugins.explorer.server import explorer_page  # noqa: PLC0415  it needs an extra

    yield from explorer_page(job, port=port, browser=browser)
