import control as control
import jinja2 as jinja2
import numba as numba
import pint as pint
import pydantic as pydantic
import sympy as sympy
import uncertainties as uncertainties
from llvmlite import binding as binding
from scipy import fft as fft
from scipy import interpolate as interpolate
from scipy import io as io
from scipy import linalg as linalg
from scipy import signal as signal
from scipy import stats as stats

from masking.compile.numerics import compilation as compilation
from masking.compile.numerics import delayed as delayed
from masking.compile.numerics import events as events
from masking.compile.numerics import kalman_kernels as kalman_kernels
from masking.compile.numerics import known_motion as known_motion
from masking.compile.numerics import lanes as lanes
from masking.compile.numerics import motion_sensitivities as motion_sensitivities
from masking.compile.numerics import runge_kutta as runge_kutta
from masking.compile.numerics import safety_kernels as safety_kernels
from masking.compile.numerics import sampled_loop as sampled_loop
from masking.compile.numerics import single_step as single_step
from masking.compile.numerics import taylor_integrator as taylor_integrator
from masking.compile.numerics import virtual_input_kernels as virtual_input_kernels
from masking.display import axes as axes
from masking.display import fragments as fragments
from masking.display import series_views as series_views
from masking.lab.records import hdf5 as hdf5
from masking.lab.records import parquet as parquet
from masking.model.modelling import typeset as typeset
from masking.reports import animation_frames as animation_frames
from masking.reports import one_page_drawing as one_page_drawing
from masking.reports import run_figures as run_figures
from masking.reports import style as style
