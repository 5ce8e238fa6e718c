"""The experiment of Jia et al. 2020 (Sensors 20, 2603) on a simulated joint, table by table."""
