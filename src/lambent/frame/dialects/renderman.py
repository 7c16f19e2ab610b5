"""RenderMan: the channels its own denoiser asks for.

Names from the denoiser's configuration in RenderMan 20 to 26 (``denoise``, ``denoise_batch``) as
public pipeline tools set it up: ``Ci a mse sampleCount albedo albedo_mse albedo_var diffuse
diffuse_mse specular specular_mse normal normal_mse normal_var zfiltered zfiltered_var forward
backward``, and light by path expressions (``directDiffuse``…). By RenderMan's documentation the
statistic ``mse`` is the variance over the number of samples, ``variance`` that of the samples.
Space of ``normal`` (``Nn`` or the expression ``CU6L``): not verified, so unknown.
Header attributes of RenderMan: not verified; the names are the proof.
"""

from __future__ import annotations

from lambent.frame.dialects.table import Dialect, Rule
from lambent.frame.role import Role, Stat

_VARIED = (
    ("albedo", Role.ALBEDO),
    ("normal", Role.NORMAL),
    ("zfiltered|z", Role.DEPTH),
    ("diffuse", Role.DIFFUSE),
    ("specular", Role.SPECULAR),
    ("Ci", Role.COLOUR),
)

RENDERMAN = Dialect(
    name="renderman",
    title="RenderMan",
    header=(r"(Software|renderer)=.*(RenderMan|prman).*", r"rman.*=.*"),
    names=(
        r"Ci",
        r"mse",
        r"sampleCount",
        r"albedo_(mse|var)",
        r"normal_(mse|var)",
        r"(diffuse|specular)_mse",
        r"zfiltered(_var)?",
        r"(in)?directDiffuse",
        r"(in)?directSpecular",
        r"backward",
    ),
    rules=(
        Rule(r"Ci|RGBA?", Role.COLOUR, "the beauty"),
        Rule(r"a|Oi", Role.ALPHA, "opacity"),
        Rule(r"mse", Role.COLOUR, "mean squared error of the beauty", Stat.VARIANCE),
        Rule(r"mse_?var|filteredmse", Role.OTHER, "statistics"),
        *(
            Rule(f"({name})_mse", role, "mean squared error", Stat.VARIANCE)
            for name, role in _VARIED
        ),
        *(
            Rule(f"({name})_var", role, "variance of the samples", Stat.VARIANCE, per_sample=True)
            for name, role in _VARIED
        ),
        Rule(r"albedo", Role.ALBEDO, "albedo"),
        Rule(r"normal|Nn", Role.NORMAL, "shading normal"),
        Rule(r"zfiltered", Role.DEPTH, "depth, filtered as the beauty"),
        Rule(r"z|z\.z|zback", Role.DEPTH, "depth of the nearest sample"),
        Rule(r"__?Pworld", Role.POSITION, "position"),
        Rule(r"backward|motionBack", Role.MOTION, "to the previous frame, in pixels"),
        Rule(r"forward|motionFore", Role.OTHER, "motion to the next frame"),
        Rule(r"sampleCount|cpuTime", Role.OTHER, "statistics"),
        Rule(r"diffuse", Role.DIFFUSE, "all diffuse light"),
        Rule(r"specular", Role.SPECULAR, "all specular light"),
        Rule(r"emissive", Role.EMISSION, "light that surfaces give off"),
        Rule(
            r"(in)?direct(Diffuse|Specular)(Lobe)?|subsurface(Lobe)?|transmissive(Lobe|Glass\w*)?"
            r"|(user|beauty)\w*Lobe|LPE\w*|lg_.+|caustics",
            Role.LIGHTING,
            "light of a path expression",
        ),
    ),
    verified="denoise configurations of public pipeline tools; RenderMan documentation (Denoising)",
)
