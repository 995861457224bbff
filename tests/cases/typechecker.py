"""The type checker of the suite: every call into the package is checked against its annotations, shapes included."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
