"""Equations of flight: coefficient terms and polynomials, coefficients from accelerations, residuals, equations of motion."""
