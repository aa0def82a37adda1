//! Generates Rust types from the message files of `tests.interop.interface_files`.
//!
//! Packages that hiroz-codegen brings along are taken from there, so that their definitions are
//! independent of zensim's.

use std::collections::HashSet;
use std::env;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use hiroz_codegen::discovery::discover_package_name;
use hiroz_codegen::{GeneratorConfig, MessageGenerator, discover_bundled_packages};

/// One folder for each version of the interfaces: their names are equal.
const VERSIONS: &[&str] = &["newest", "v1"];

fn main() -> Result<()> {
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let files = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("interfaces");
    println!("cargo:rerun-if-changed={}", files.display());
    for version in VERSIONS {
        generate(&files.join(version), &out.join(version))?;
    }
    Ok(())
}

fn generate(files: &Path, out: &Path) -> Result<()> {
    std::fs::create_dir_all(out)?;
    let mut packages = list_bundled(files)?;
    for entry in std::fs::read_dir(files).with_context(|| format!("no files in {files:?}"))? {
        packages.push(entry?.path());
    }
    let config = GeneratorConfig {
        generate_cdr: true,
        generate_protobuf: false,
        generate_type_info: true,
        is_humble: env::var("CARGO_FEATURE_HUMBLE").is_ok(),
        output_dir: out.to_path_buf(),
        external_crate: None,
        local_packages: HashSet::new(),
        json_out: Some(out.join("manifest.json")),
    };
    let paths: Vec<&Path> = packages.iter().map(PathBuf::as_path).collect();
    MessageGenerator::new(config).generate_from_msg_files(&paths)
}

fn list_bundled(files: &Path) -> Result<Vec<PathBuf>> {
    let names = std::fs::read_to_string(files.with_file_name("bundled.txt"))?;
    let mut found = Vec::new();
    for path in discover_bundled_packages(false)? {
        let name = discover_package_name(&path)?;
        if names.lines().any(|line| line == name) {
            found.push(path);
        }
    }
    Ok(found)
}
