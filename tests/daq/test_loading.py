"""What a long-running process is made of: left alone by the search for what can go."""

import gc

import pytest

from daq.process.loading import loading


@pytest.fixture(autouse=True)
def as_before():
    yield
    gc.unfreeze()
    gc.enable()


def test_what_is_loaded_is_never_searched_and_what_comes_afterwards_is():
    with loading():
        assert not gc.isenabled()
        loaded = [object()]
    afterwards = [object()]
    searched = {id(one) for one in gc.get_objects()}
    assert gc.isenabled()
    assert id(loaded) not in searched
    assert id(afterwards) in searched


def test_a_module_that_cannot_be_loaded_leaves_the_search_on():
    with pytest.raises(ImportError), loading():
        raise ImportError
    assert gc.isenabled()
