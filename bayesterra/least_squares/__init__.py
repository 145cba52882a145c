"""IM1, IM2, IM3 and joint: the point estimates beside the posterior (Ding et al. 2015)."""
