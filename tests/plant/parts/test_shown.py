"""What a result shows: text, HTML that is well formed, escaped and needs nothing, a short repr."""

from html.parser import HTMLParser

import pytest

from plant.parts import Aside, Shown, Table, Verdict, Warned, body, inside, table

NASTY = "<script>alert('x')</script> & \"q\""
VOID = ("br", "hr", "img", "meta", "input", "link")


class Page(HTMLParser):
    """Tags in their order, closed in theirs; the text outside the style."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.words = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.words.append(data)


class Example(Shown):
    def __init__(self, good=True):
        self.good = good

    def _short(self):
        return "an example"

    def _shown(self):
        yield Verdict(f"It holds {NASTY}", self.good)
        yield Table(("", NASTY), [(NASTY, "1"), ("b", "2.5")])
        yield "A sentence " * 20 + NASTY
        yield Warned([NASTY, "a second one"])
        yield Table((), [])
        yield Aside(NASTY, [f"f1 = {NASTY}"])


def test_html_is_well_formed_escaped_and_self_contained():
    html = Example()._repr_html_()
    page = Page(html)
    assert {tag for tag, _ in page.tags} == {
        "div",
        "style",
        "p",
        "b",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
        "ul",
        "li",
        "details",
        "summary",
        "pre",
    }
    assert "".join(page.words).count(NASTY) == 7
    assert "<script" not in html
    assert not any(
        name in ("src", "href", "onclick") for _, attributes in page.tags for name in attributes
    )
    assert "http" not in html
    assert "@import" not in html
    assert len(html) < 4000


def test_the_verdict_is_first_and_marked_by_more_than_its_colour():
    for good, mark in ((True, "✓ "), (False, "✗ "), (None, "")):
        words = [word for word in Page(Example(good)._repr_html_()).words if word.strip()]
        assert words[0] == f"{mark}It holds {NASTY}"


def test_the_page_decides_on_the_colours_of_text_and_ground():
    style = Example()._repr_html_().partition("<style>")[2].partition("</style>")[0]
    assert "background" not in style
    assert not [line for line in style.split(";") if line.strip().startswith("color")]
    assert all(rule.strip().startswith(".onepulse") for rule in style.replace(",", "}").split("}")
               if "{" in rule and "rgba" not in rule)  # fmt: skip


def test_numbers_stand_to_the_right():
    kinds = [
        attributes.get("class") for tag, attributes in Page(body(Example())).tags if tag == "td"
    ]
    assert kinds == [None, "number", None, "number"]


def test_a_table_without_rows_is_not_there():
    assert Example()._repr_html_().count("<table>") == 1


def test_units_stay_whole():
    assert "N&nbsp;m]" in table(("", "torque [N m]"), [("a", "1")])


def test_text_is_80_columns_wide_and_its_warnings_are_called_so():
    lines = str(Example()).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0] == f"It holds {NASTY}"
    assert [line for line in lines if line.startswith("warning: ")] == [
        f"warning: {NASTY}",
        "warning: a second one",
    ]
    assert lines[-1] == f"f1 = {NASTY}"


def test_inside_another_result_the_verdict_is_a_sentence():
    first, *others = inside(Example())
    assert first == f"It holds {NASTY}"
    assert not any(isinstance(piece, Verdict) for piece in others)
    assert repr(Example()) == "Example(an example)"


def test_a_repr_has_100_letters_at_most(monkeypatch):
    for length in (80, 91, 92, 500):
        monkeypatch.setattr(Example, "_short", lambda _, length=length: "x" * length)
        said = repr(Example())
        assert len(said) == min(length + 9, 100)
        assert said.endswith(" ...)") == (length > 91)
    monkeypatch.setattr(Example, "_short", lambda _: "a name\nof two lines")
    assert repr(Example()) == "Example(a name of two lines)"


@pytest.mark.parametrize(("call", "said"), [(str, "Define _shown"), (repr, "Define _short")])
def test_a_result_that_says_nothing_is_refused_in_one_line(call, said):
    with pytest.raises(NotImplementedError, match=said):
        call(Shown())
