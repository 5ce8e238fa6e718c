"""Plant B, a joint as a mechanical engineer sees it.

LuGre friction and a Bouc-Wen cable are stepped along the shaft's path, torques twist shaft and coupling, heat is
stepped through a row of nodes along the joint, the bearing's orders come from its balls; the head's reading is a
power series in the eccentricity; noise is fractional with a mixture's tails and stick-slip bursts.
"""
