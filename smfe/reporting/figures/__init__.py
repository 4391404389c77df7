"""The figures: what they hold, drawn interactive for the page (`plotly_*`) and as PNG (`draw_matplotlib`)."""
