"""From a study to a posterior density: the model at the rows, likelihoods, derivatives."""
