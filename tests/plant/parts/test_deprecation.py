"""Old names and old orders of arguments: they give what the new ones give, and the warning is where the user is."""

import warnings

import pytest

from plant.parts.deprecation import Renamed, install, old_option, old_order, warn_renamed


class Thing:
    class Inner:
        value = 7

    inner = Inner()

    def double(self, x):
        return 2 * x


install(Thing, twice="double", value="inner.value")


def test_an_old_method_and_an_old_path_work_and_warn_where_they_are_used():
    with pytest.warns(
        DeprecationWarning, match=r"^Thing\.twice will go in the next release\. Use Thing\.double\.$"
    ) as said:
        assert Thing().twice(4) == 8
    assert said[0].filename == __file__
    with pytest.warns(DeprecationWarning, match=r"Thing\.value .* Use Thing\.inner\.value"):
        assert Thing().value == 7


def test_the_class_itself_does_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert isinstance(Thing.twice, Renamed)
        assert Thing().double(3) == 6


def test_a_subclass_is_named():
    class Other(Thing):
        pass

    with pytest.warns(DeprecationWarning, match=r"Other\.twice .* Use Other\.double"):
        assert Other().twice(1) == 2


def test_an_old_order_of_arguments():
    @old_order("b", "a", new="f(a, b)", first=str)
    def f(a, b, *, c=0):
        return a, b, c

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert f(1, "b", c=3) == (1, "b", 3)
        assert f(a=1, b="b") == (1, "b", 0)
    with pytest.warns(DeprecationWarning, match=r"^f\(b, a\) will go in the next release\. Use f\(a, b\)\.$") as said:
        assert f("b", 1, c=3) == (1, "b", 3)
    assert said[0].filename == __file__
    assert f.__name__ == "f"


def test_a_warning_of_one_s_own():
    with pytest.warns(DeprecationWarning, match=r"^old will go in the next release\. Use new\.$") as said:
        warn_renamed("old", "new", stacklevel=2)
    assert said[0].filename == __file__


def test_an_option_under_its_old_name_works_and_says_so():
    @old_option("axes", "ax")
    def draw(thing, *, ax=None):
        return thing, ax

    with pytest.warns(DeprecationWarning, match=r"draw\(axes=\) will go in the next release. Use draw\(ax=\)") as said:
        assert draw(1, axes=2) == (1, 2)
    assert said[0].filename == __file__
    assert draw(1, ax=2) == (1, 2)
    assert draw(1) == (1, None)
