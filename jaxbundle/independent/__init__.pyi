from jaxbundle.independent.model_adjustment import ModelAdjustment as ModelAdjustment, adjust_models as adjust_models
from jaxbundle.independent.plan_height_iteration import PlanHeight as PlanHeight, plan_height as plan_height
from jaxbundle.independent.strip_adjustment import StripAdjustment as StripAdjustment, adjust_strips as adjust_strips
