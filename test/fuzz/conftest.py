"""What the fuzz tests share: a folder for all inputs of a test, and how many there were."""

from fuzz.counting import GIVEN
import pytest


@pytest.fixture
def place(tmp_path):
    """Return a folder that the inputs of a test use one after the other."""
    return tmp_path


def pytest_terminal_summary(terminalreporter):
    """Say how many inputs of each kind were tried."""
    if GIVEN:
        kinds = ', '.join(f'{count} {kind}' for kind, count in sorted(GIVEN.items()))
        terminalreporter.write_line(f'fuzzed inputs: {GIVEN.total()} ({kinds})')
