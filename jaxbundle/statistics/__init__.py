"""What the residuals tell: precision, reliability, variance components, the influence of control's errors."""
