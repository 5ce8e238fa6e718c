"""How good a model is: judged by what it was not trained on, and on simulated joints by the truth."""
