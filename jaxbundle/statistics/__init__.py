"""What the residuals tell: variance components of heterogeneous measurements, and the influence of control's errors."""
