"""What the orc is made of: skin, hair, ivory, eyes, gold, as materials of its stage."""


def look(name, **inputs):
    """A Material with one UsdPreviewSurface; keyword values are (type, value) pairs."""
    lines = "".join(
        f"\n                {kind} inputs:{key} = {value}" for key, (kind, value) in inputs.items()
    )
    return f'''
        def Material "{name}"
        {{
            token outputs:surface.connect = </World/Looks/{name}/Surface.outputs:surface>

            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"{lines}
                token outputs:surface
            }}
        }}
'''


def skin():
    """A medium whose colour a map gives, pores by another, and a wet layer by a third."""
    mapped = {"subsurfaceColor": "Color.outputs:rgb", "normal": "Pores.outputs:rgb"}
    mapped |= {
        "clearcoat": "Wet.outputs:r",
        "clearcoatRoughness": "Wet.outputs:g",
        "roughness": "Wet.outputs:b",
    }
    kinds = {"subsurfaceColor": "color3f", "normal": "normal3f"}
    lines = "".join(
        f"\n                {kinds.get(key, 'float')} inputs:{key}.connect = </World/Looks/Skin/{source}>"
        for key, source in mapped.items()
    )
    images = (
        uv_texture("Skin", "Color", "orc_color.jpg", "sRGB", "float3 outputs:rgb")
        + uv_texture("Skin", "Pores", "orc_normal.jpg", "raw", "float3 outputs:rgb", PORES)
        + uv_texture(
            "Skin", "Wet", "orc_wet.jpg", "raw", "float outputs:r", "float outputs:g", "float outputs:b"
        )
    )
    return f'''
        def Material "Skin"
        {{
            token outputs:surface.connect = </World/Looks/Skin/Surface.outputs:surface>

            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                float inputs:ior = 1.4
                float inputs:subsurface = 1
                color3f inputs:subsurfaceRadius = (0.055, 0.02, 0.012)
                token inputs:subsurfaceBoundary = "diffuse"{lines}
                token outputs:surface
            }}
{COORDINATES}{images}        }}
'''


PORES = "float4 inputs:scale = (2, 2, 2, 1)", "float4 inputs:bias = (-1, -1, -1, 0)"


COORDINATES = """
            def Shader "Coordinates"
            {
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }
"""


def uv_texture(look, name, file, space, *lines):
    lines = [line for group in lines for line in (group if isinstance(group, tuple) else (group,))]
    body = "".join(f"\n                {line}" for line in lines)
    return f'''
            def Shader "{name}"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./textures/{file}@
                token inputs:sourceColorSpace = "{space}"
                token inputs:wrapS = "repeat"
                token inputs:wrapT = "clamp"
                float2 inputs:st.connect = </World/Looks/{look}/Coordinates.outputs:result>{body}
            }}
'''


def hair():
    """Dark brown by melanin, as MaterialX' nodes say it."""
    return """
        def Material "Hair"
        {
            token outputs:mtlx:surface.connect = </World/Looks/Hair/Surface.outputs:out>

            def Shader "Surface"
            {
                uniform token info:id = "ND_surface"
                token inputs:bsdf.connect = </World/Looks/Hair/Strand.outputs:out>
                token outputs:out
            }

            def Shader "Strand"
            {
                uniform token info:id = "ND_chiang_hair_bsdf"
                float inputs:cuticle_angle = 0.515
                float3 inputs:absorption_coefficient.connect = </World/Looks/Hair/Melanin.outputs:absorption>
                float2 inputs:roughness_R.connect = </World/Looks/Hair/Roughness.outputs:roughness_R>
                float2 inputs:roughness_TT.connect = </World/Looks/Hair/Roughness.outputs:roughness_TT>
                float2 inputs:roughness_TRT.connect = </World/Looks/Hair/Roughness.outputs:roughness_TRT>
                token outputs:out
            }

            def Shader "Melanin"
            {
                uniform token info:id = "ND_deon_hair_absorption_from_melanin"
                float inputs:melanin_concentration = 0.9
                float inputs:melanin_redness = 0.35
                float3 outputs:absorption
            }

            def Shader "Roughness"
            {
                uniform token info:id = "ND_chiang_hair_roughness"
                float inputs:longitudinal = 0.3
                float inputs:azimuthal = 0.35
                float2 outputs:roughness_R
                float2 outputs:roughness_TT
                float2 outputs:roughness_TRT
            }
        }
"""


def scattering(name, color, mean_free_path, roughness, **more):
    return look(
        name,
        diffuseColor=("color3f", color),
        ior=("float", 1.4),
        roughness=("float", roughness),
        **more,
        subsurface=("float", 1),
        subsurfaceColor=("color3f", color),
        subsurfaceRadius=("color3f", mean_free_path),
        subsurfaceBoundary=("token", '"diffuse"'),
    )


def eye():
    """White, iris and pupil by a map; their own gloss is that of flesh in water."""
    image = uv_texture("Eye", "Color", "orc_eye.jpg", "sRGB", "float3 outputs:rgb")
    return f"""
        def Material "Eye"
        {{
            token outputs:surface.connect = </World/Looks/Eye/Surface.outputs:surface>

            def Shader "Surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor.connect = </World/Looks/Eye/Color.outputs:rgb>
                float inputs:ior = 1.05
                float inputs:roughness = 0.5
                token outputs:surface
            }}
{COORDINATES}{image}        }}
"""


def tears():
    """Cornea and tears: a smooth dielectric that mirrors and lets the rest go straight on, so that light is sampled
    through it. Refraction would leave the iris to what meets a light by chance."""
    return look(
        "Tears",
        diffuseColor=("color3f", "(0, 0, 0)"),
        ior=("float", 1.376),
        opacity=("float", 0),
        # Smooth to the eye; with less, only the fortieth of the samples that mirror would find a light.
        roughness=("float", 0.15),
    )


def looks():
    coat = {"clearcoat": ("float", 0.5), "clearcoatRoughness": ("float", 0.15)}
    parts = [
        "\n        # Very thick: the red mean free path is about a tenth of the ear's membrane (0.4 to 0.5 cm).",
        skin(),
        hair(),
        scattering("Ivory", "(0.86, 0.77, 0.58)", "(0.11, 0.075, 0.045)", 0.3, **coat),
        "\n        # The eye: a painted ball, its iris set back, below a clear cornea that ends as a film of tears.",
        eye(),
        tears(),
        look(
            "Gold",
            diffuseColor=("color3f", "(0.86, 0.6, 0.26)"),
            metallic=("float", 1),
            roughness=("float", 0.28),
        ),
        look("Backdrop", diffuseColor=("color3f", "(0.1, 0.11, 0.13)"), roughness=("float", 0.9)),
    ]
    return "".join(parts)
