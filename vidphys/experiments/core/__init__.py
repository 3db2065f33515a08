"""What every table stands on: cells, training, questions, bars, figures."""
