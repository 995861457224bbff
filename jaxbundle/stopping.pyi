from jaxbundle.solve.stopping_rules import (
    AngleRule as AngleRule,
    PointRule as PointRule,
    parallax_rule as parallax_rule,
    unknown_rule as unknown_rule,
)
