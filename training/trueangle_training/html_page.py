"""Pages as single files: every value escaped, an undefined name an error, nothing from a network."""

from collections.abc import Mapping

import jinja2
from markupsafe import Markup


def page(template: str, values: Mapping[str, object]) -> str:
    """The template of this package filled in; only `Markup` values are taken as HTML."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("trueangle_training", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(values)


__all__ = ["Markup", "page"]
