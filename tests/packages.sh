# Installs what packages.txt (the one list) names, if anything of it is missing. To be sourced from the repository root.
mapfile -t packages < <(grep -v '^#' packages.txt)
if ! dpkg-query -W -f='${db:Status-Abbrev}\n' "${packages[@]}" >/dev/null 2>&1 ||
  dpkg-query -W -f='${db:Status-Abbrev}\n' "${packages[@]}" 2>/dev/null | grep -qv '^ii'; then
  sudo=""
  [ "$(id -u)" = 0 ] || sudo=sudo
  $sudo apt-get update -qq
  $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${packages[@]}" >/dev/null
fi
