#include <fmt/format.h>

#include <filesystem>
#include <functional>
#include <memory>

#include "libbrdf/files.h"
#include "tools/command.h"

namespace lacquer::tools {

namespace {

/// Text for troff: no line begins with a control character, minus signs are those of a keyboard.
std::string roff(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\') out += "\\e";
    else if (c == '-') out += "\\-";
    else out += c;
  }
  if (!out.empty() && (out[0] == '.' || out[0] == '\'')) out.insert(0, "\\&");
  return out;
}

std::string quoted_for_shell(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\'') out += "'\\''";
    else out += c;
  }
  return out;
}

bool is_flag(const CLI::Option& option) { return option.get_expected_max() == 0; }

std::string value_name(const CLI::Option& option) { return is_flag(option) ? "" : " " + (option.get_type_name().empty() ? std::string("VALUE") : option.get_type_name()); }

std::string options_of(const CLI::App& app) {
  std::string positionals, named;
  for (const CLI::Option* option : app.get_options()) {
    std::string text = roff(option->get_description());
    if (!option->get_default_str().empty()) text += fmt::format(" (default: {})", roff(option->get_default_str()));
    const std::string name = option->get_positional() ? option->get_name(true, false) : option->get_name(false, true);
    (option->get_positional() ? positionals : named) += fmt::format(".TP\n.B {}\n{}\n", roff(name + (option->get_positional() ? "" : value_name(*option))), text);
  }
  return (positionals.empty() ? "" : ".SH ARGUMENTS\n" + positionals) + (named.empty() ? "" : ".SH OPTIONS\n" + named);
}

std::string synopsis(const CLI::App& app, const std::string& name) {
  std::string text = fmt::format(".B {}\n[options]", roff(name));
  if (!app.get_subcommands([](const CLI::App* s) { return !s->get_group().empty(); }).empty()) text += " command";
  for (const CLI::Option* option : app.get_options())
    if (option->get_positional()) text += fmt::format(fmt::runtime(option->get_required() ? " {}{}" : " [{}]{}"), roff(option->get_name(true, false)), option->get_expected_max() > 1 ? "..." : "");
  return text + "\n";
}

/// Subcommands that are shown.
std::vector<CLI::App*> commands_of(CLI::App& app) {
  return app.get_subcommands([](CLI::App* s) { return !s->get_group().empty(); });
}

void write_man_pages(CLI::App& app, const std::string& name, const std::filesystem::path& folder) {
  std::string dashed = name;
  for (char& c : dashed)
    if (c == ' ') c = '-';
  std::string page = fmt::format(".TH {} 1 \"\" \"lacquer {}\" \"Lacquer\"\n.SH NAME\n{} \\- {}\n.SH SYNOPSIS\n{}", roff(dashed), brdf::version(), roff(dashed), roff(app.get_description()),
                                 synopsis(app, name));
  page += options_of(app);
  if (const auto commands = commands_of(app); !commands.empty()) {
    page += ".SH COMMANDS\n";
    for (const CLI::App* command : commands) page += fmt::format(".TP\n.B {}\n{}\n", roff(command->get_name()), roff(command->get_description()));
  }
  page += ".SH EXIT STATUS\n0: good. 1: failed, one line on stderr says what and what to do. 2: usage. 130: interrupted.\n";
  page += dashed == "lacquer" ? ".SH SEE ALSO\nThe documents beside the README; each command has a page of its own, lacquer\\-COMMAND(1).\n" : ".SH SEE ALSO\n.BR lacquer (1)\n";
  brdf::write_text_atomically(folder / (dashed + ".1"), page);
  for (CLI::App* command : commands_of(app)) write_man_pages(*command, name + " " + command->get_name(), folder);
}

/// Long names of the options, "--json --quiet".
std::string long_options(const CLI::App& app) {
  std::string text;
  for (const CLI::Option* option : app.get_options())
    for (const auto& name : option->get_lnames()) text += (text.empty() ? "--" : " --") + name;
  return text;
}

void each_command(CLI::App& app, const std::string& path, const std::function<void(CLI::App&, const std::string&)>& use) {
  for (CLI::App* command : commands_of(app)) {
    const std::string name = path.empty() ? command->get_name() : path + " " + command->get_name();
    use(*command, name);
    each_command(*command, name, use);
  }
}

std::string names_of(CLI::App& app) {
  std::string text;
  for (const CLI::App* command : commands_of(app)) text += (text.empty() ? "" : " ") + command->get_name();
  return text;
}

std::string bash_completion(CLI::App& app) {
  std::string cases;
  each_command(app, "", [&](CLI::App& command, const std::string& path) {
    cases += fmt::format("    '{}') words='{} {}' ;;\n", path, names_of(command), long_options(command));
  });
  return fmt::format(
      "# bash completion of lacquer\n_lacquer() {{\n  local current=\"${{COMP_WORDS[COMP_CWORD]}}\" path='' words word\n"
      "  for word in \"${{COMP_WORDS[@]:1:COMP_CWORD-1}}\"; do\n"
      "    case \" {} \" in *\" $word \"*) path=\"${{path:+$path }}$word\" ;; esac\n  done\n"
      "  case \"$path\" in\n{}    *) words='{} {}' ;;\n  esac\n"
      "  if [[ $current == -* || ( -z $path && $COMP_CWORD -eq 1 ) ]]; then\n    COMPREPLY=($(compgen -W \"$words\" -- \"$current\"))\n"
      "  else\n    COMPREPLY=($(compgen -W \"${{words%% --*}}\" -- \"$current\") $(compgen -f -- \"$current\"))\n  fi\n}}\n"
      "complete -o filenames -F _lacquer lacquer\n",
      [&] {
        std::string all;
        each_command(app, "", [&](CLI::App& command, const std::string&) { all += (all.empty() ? "" : " ") + command.get_name(); });
        return all;
      }(),
      cases, names_of(app), long_options(app));
}

std::string zsh_completion(CLI::App& app) {
  std::string commands, cases;
  for (const CLI::App* command : commands_of(app)) commands += fmt::format("    '{}:{}'\n", command->get_name(), quoted_for_shell(command->get_description()));
  for (CLI::App* command : commands_of(app)) {
    std::string options;
    for (const CLI::Option* option : command->get_options())
      for (const auto& name : option->get_lnames()) {
        std::string description = quoted_for_shell(option->get_description());
        for (char& c : description)
          if (c == '[' || c == ']' || c == ':') c = ' ';
        options += fmt::format(" '--{}{}[{}]{}'", name, is_flag(*option) ? "" : "=", description, is_flag(*option) ? "" : ":value:_files");
      }
    const std::string inner = names_of(*command);
    cases += fmt::format("    {}) _arguments{} {} '*:file:_files' ;;\n", command->get_name(), options, inner.empty() ? "" : fmt::format("'1:part:({})'", inner));
  }
  return fmt::format("#compdef lacquer\n_lacquer() {{\n  local -a commands=(\n{}  )\n  if (( CURRENT == 2 )); then\n    _describe command commands\n    return\n  fi\n  local command=$words[2]\n"
                     "  shift words\n  (( CURRENT-- ))\n  case $command in\n{}  esac\n}}\n_lacquer \"$@\"\n",
                     commands, cases);
}

std::string fish_completion(CLI::App& app) {
  std::string text = "# fish completion of lacquer\n";
  for (CLI::App* command : commands_of(app)) {
    text += fmt::format("complete -c lacquer -n __fish_use_subcommand -a {} -d '{}'\n", command->get_name(), quoted_for_shell(command->get_description()));
    for (CLI::App* part : commands_of(*command)) text += fmt::format("complete -c lacquer -n '__fish_seen_subcommand_from {}' -a {} -d '{}'\n", command->get_name(), part->get_name(), quoted_for_shell(part->get_description()));
    for (const CLI::Option* option : command->get_options())
      for (const auto& name : option->get_lnames())
        text += fmt::format("complete -c lacquer -n '__fish_seen_subcommand_from {}' -l {}{} -d '{}'\n", command->get_name(), name, is_flag(*option) ? "" : " -r", quoted_for_shell(option->get_description()));
  }
  return text;
}

}  // namespace

void add_documentation(CLI::App& app) {
  auto folder = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand("documentation", "man pages and shell completion, from the commands themselves");
  command->group("");  // for the build and the installation, not for people
  command->add_option("folder", *folder, "folder to write man/ and completion/ into")->required();
  command->callback([folder, &app] {
    const std::filesystem::path root = *folder;
    std::filesystem::create_directories(root / "man");
    std::filesystem::create_directories(root / "completion");
    write_man_pages(app, "lacquer", root / "man");
    brdf::write_text_atomically(root / "completion" / "lacquer.bash", bash_completion(app));
    brdf::write_text_atomically(root / "completion" / "_lacquer", zsh_completion(app));
    brdf::write_text_atomically(root / "completion" / "lacquer.fish", fish_completion(app));
  });
}

}  // namespace lacquer::tools
