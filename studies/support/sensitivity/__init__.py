"""How outcomes answer to the parameters: the analysis of Ding et al. (2015), Section 4, and Sobol indices."""
