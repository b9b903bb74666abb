//! Compiles every shader to SPIR-V 1.3 (Vulkan 1.1): what a Quest's driver takes.

use glslang::{
    Compiler, CompilerOptions, ShaderInput, ShaderSource, ShaderStage, SourceLanguage, SpirvVersion, Target,
    VulkanVersion,
};
use std::collections::HashSet;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::{env, fs};

/// Constant name, source file, macros.
const SHADERS: &[(&str, &str, &[&str])] = &[
    ("PROJECT_COMP", "project.comp", &[]),
    ("COUNT_COMP", "count.comp", &[]),
    ("PLAN_COMP", "plan.comp", &[]),
    ("EMIT_COMP", "emit.comp", &[]),
    ("SORT_KEYS_COMP", "sort_keys.comp", &[]),
    ("SORT_COUNT_COMP", "sort_count.comp", &[]),
    ("SORT_SCAN_COMP", "sort_scan.comp", &[]),
    ("SORT_SCATTER_COMP", "sort_scatter.comp", &[]),
    ("SORT_SHUFFLED_SCATTER_COMP", "sort_shuffled_scatter.comp", &[]),
    ("SCHEDULE_COMP", "schedule.comp", &[]),
    ("TILE_SPLATS_COMP", "tile_splats.comp", &[]),
    ("TILE_LIST_COMP", "tile_splats.comp", &["LIST"]),
    ("TILE_SCAN_COMP", "tile_scan.comp", &[]),
    ("TILE_BLEND_COMP", "tile_blend.comp", &[]),
    ("TILE_BLEND_COMP_COUNT", "tile_blend.comp", &["COUNT"]),
    ("TILE_SHOW_FRAG", "tile_show.frag", &[]),
    ("TILE_SHOW_FRAG_COUNT", "tile_show.frag", &["COUNT"]),
    ("TILE_SHOW_FRAG_MULTIVIEW", "tile_show.frag", &["MULTIVIEW"]),
    ("TILE_SHOW_FRAG_MULTIVIEW_COUNT", "tile_show.frag", &["MULTIVIEW", "COUNT"]),
    ("SPLAT_VERT", "splat.vert", &[]),
    ("SPLAT_VERT_EXACT", "splat.vert", &["EXACT"]),
    ("SPLAT_VERT_MULTIVIEW", "splat.vert", &["MULTIVIEW"]),
    ("SPLAT_VERT_EXACT_MULTIVIEW", "splat.vert", &["EXACT", "MULTIVIEW"]),
    ("SPLAT_VERT_STOCHASTIC", "splat.vert", &["STOCHASTIC"]),
    ("SPLAT_VERT_EXACT_STOCHASTIC", "splat.vert", &["EXACT", "STOCHASTIC"]),
    ("SPLAT_VERT_MULTIVIEW_STOCHASTIC", "splat.vert", &["MULTIVIEW", "STOCHASTIC"]),
    ("SPLAT_VERT_EXACT_MULTIVIEW_STOCHASTIC", "splat.vert", &["EXACT", "MULTIVIEW", "STOCHASTIC"]),
    ("SPLAT_FRAG_STOCHASTIC", "splat.frag", &["STOCHASTIC"]),
    ("SPLAT_FRAG_EXACT_STOCHASTIC", "splat.frag", &["EXACT", "STOCHASTIC"]),
    ("SPLAT_VERT_LENS", "splat.vert", &["THROUGH_LENS"]),
    ("SPLAT_VERT_EXACT_LENS", "splat.vert", &["EXACT", "THROUGH_LENS"]),
    ("SPLAT_FRAG_LENS", "splat.frag", &["THROUGH_LENS"]),
    ("SPLAT_FRAG_EXACT_LENS", "splat.frag", &["EXACT", "THROUGH_LENS"]),
    ("SPLAT_FRAG_LENS_COUNT", "splat.frag", &["THROUGH_LENS", "COUNT"]),
    ("SPLAT_FRAG_EXACT_LENS_COUNT", "splat.frag", &["EXACT", "THROUGH_LENS", "COUNT"]),
    ("INSTANCED_VERT", "splat_instanced.vert", &[]),
    ("INSTANCED_VERT_EXACT", "splat_instanced.vert", &["EXACT"]),
    ("INSTANCED_VERT_MULTIVIEW", "splat_instanced.vert", &["MULTIVIEW"]),
    ("INSTANCED_VERT_EXACT_MULTIVIEW", "splat_instanced.vert", &["EXACT", "MULTIVIEW"]),
    ("POINT_VERT", "splat_point.vert", &[]),
    ("SPLAT_GEOM", "splat.geom", &[]),
    ("SPLAT_GEOM_EXACT", "splat.geom", &["EXACT"]),
    ("SPLAT_FRAG", "splat.frag", &[]),
    ("SPLAT_FRAG_EXACT", "splat.frag", &["EXACT"]),
    ("SPLAT_FRAG_COUNT", "splat.frag", &["COUNT"]),
    ("SPLAT_FRAG_EXACT_COUNT", "splat.frag", &["EXACT", "COUNT"]),
    ("FULLSCREEN_VERT", "fullscreen.vert", &[]),
    ("HIDDEN_VERT", "hidden.vert", &[]),
    ("HIDDEN_VERT_MULTIVIEW", "hidden.vert", &["MULTIVIEW"]),
    ("MARK_VERT", "mark.vert", &[]),
    ("MARK_VERT_MULTIVIEW", "mark.vert", &["MULTIVIEW"]),
    ("MARK_FRAG", "mark.frag", &[]),
    ("MEDIAN_VERT", "median.vert", &[]),
    ("MEDIAN_FRAG", "median.frag", &[]),
    ("MEDIAN_FRAG_MULTIVIEW", "median.frag", &["MULTIVIEW"]),
    ("MEDIAN_DEPTH_FRAG", "median_depth.frag", &[]),
    ("MEDIAN_DEPTH_FRAG_MULTIVIEW", "median_depth.frag", &["MULTIVIEW"]),
    ("LAYERS_FRAG", "layers.frag", &[]),
    ("LAYERS_FRAG_MULTIVIEW", "layers.frag", &["MULTIVIEW"]),
    ("RESOLVE_FRAG", "resolve.frag", &[]),
    ("UPSCALE_BILINEAR_FRAG", "upscale.frag", &[]),
    ("UPSCALE_BILINEAR_FRAG_MULTIVIEW", "upscale.frag", &["MULTIVIEW"]),
    ("UPSCALE_INTERLEAVED_FRAG", "upscale.frag", &["INTERLEAVED"]),
    ("UPSCALE_INTERLEAVED_FRAG_MULTIVIEW", "upscale.frag", &["INTERLEAVED", "MULTIVIEW"]),
    ("UPSCALE_TEMPORAL_FRAG", "upscale.frag", &["INTERLEAVED", "TEMPORAL"]),
    ("UPSCALE_MEAN_FRAG", "upscale.frag", &["MEAN", "TEMPORAL"]),
    ("UPSCALE_MEAN_FRAG_MULTIVIEW", "upscale.frag", &["MEAN", "TEMPORAL", "MULTIVIEW"]),
    ("UPSCALE_TEMPORAL_FRAG_MULTIVIEW", "upscale.frag", &["INTERLEAVED", "TEMPORAL", "MULTIVIEW"]),
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=glsl");
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let compiler = Compiler::acquire().ok_or("the GLSL compiler did not start")?;
    let options = CompilerOptions {
        source_language: SourceLanguage::GLSL,
        target: Target::Vulkan { version: VulkanVersion::Vulkan1_1, spirv_version: SpirvVersion::SPIRV1_3 },
        version_profile: None,
        messages: glslang::ShaderMessage::DEFAULT,
    };
    let mut module = String::new();
    for (name, file, macros) in SHADERS {
        let stage = match Path::new(file).extension().and_then(|e| e.to_str()) {
            Some("vert") => ShaderStage::Vertex,
            Some("geom") => ShaderStage::Geometry,
            Some("frag") => ShaderStage::Fragment,
            Some("comp") => ShaderStage::Compute,
            other => return Err(format!("{file}: no shader stage for {other:?}").into()),
        };
        let text = expand(Path::new("glsl").join(file).as_path(), macros, &mut HashSet::new())?;
        let source = ShaderSource::from(text);
        let no_defines: Option<&[(&str, Option<&str>)]> = None;
        let input = ShaderInput::new(&source, stage, &options, no_defines, None)?;
        let shader = compiler.create_shader(input).map_err(|e| format!("{file} {macros:?}: {e}"))?;
        let words = shader.compile().map_err(|e| format!("{file} {macros:?}: {e}"))?;
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        fs::write(out.join(format!("{name}.spv")), bytes)?;
        module.push_str(&format!(
            "/// `{file}`{}.\npub static {name}: &[u32] = &spirv::<{}, {}>(include_bytes!(concat!(env!(\"OUT_DIR\"), \"/{name}.spv\")));\n",
            if macros.is_empty() { String::new() } else { format!(" with {}", macros.join(", ")) },
            4 * words.len(),
            words.len(),
        ));
    }
    fs::write(out.join("modules.rs"), module)?;
    Ok(())
}

/// The source with its includes pasted in (each once) and the macros defined after the `#version` line.
fn expand(path: &Path, macros: &[&str], seen: &mut HashSet<PathBuf>) -> Result<String, Box<dyn Error>> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    let mut expanded = String::new();
    for line in text.lines() {
        if let Some(included) = line.strip_prefix("#include \"").and_then(|l| l.strip_suffix('"')) {
            let included = path.with_file_name(included);
            if seen.insert(included.clone()) {
                expanded.push_str(&expand(&included, &[], seen)?);
            }
        } else {
            expanded.push_str(line);
            expanded.push('\n');
        }
        if line.starts_with("#version") {
            for m in macros {
                expanded.push_str(&format!("#define {m}\n"));
            }
        }
    }
    Ok(expanded)
}
