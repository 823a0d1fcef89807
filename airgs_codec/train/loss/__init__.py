"""How far a rendered picture is from the filmed one, with gradients."""
