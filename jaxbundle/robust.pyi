from jaxbundle.solve.weight_functions import Cauchy as Cauchy, Danish as Danish, Huber as Huber, Tukey as Tukey
